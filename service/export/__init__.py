"""Writes bodies as files that other programs read; one file a format.

::

    .nrrd .seg.nrrd   label volumes                      stored.py
    .nii .nii.gz      the same                           nifti_file.py
    .vtu .vtk .msh    meshes, with stress and strain     mesh_file.py
    .stl              the surface                        surface_file.py
    .pvd .gif         the way from rest to load          time_series.py, movie.py
    .inp .feb         the whole model, for CalculiX      calculix.py, febio.py
                      (or Abaqus) and for FEBio

What another solver is told stands in `solver_model.py`, once for both.
"""

from palpate.service.export.stored import TISSUE_NAMES, export_stored_mesh, export_volume
from palpate.service.export.suffixes import MESH_SUFFIXES, VOLUME_SUFFIXES, check_suffix

__all__ = [
    "MESH_SUFFIXES",
    "TISSUE_NAMES",
    "VOLUME_SUFFIXES",
    "check_suffix",
    "export_stored_mesh",
    "export_volume",
]
