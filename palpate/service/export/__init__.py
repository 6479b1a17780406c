"""Export of bodies to the files of other programs; one module per format.

::

    .nrrd .seg.nrrd     label volumes                      stored.py
    .nii .nii.gz        label volumes                      nifti_file.py
    .vtu .vtk .msh      meshes, with stress and strain     mesh_file.py
    .stl                the surface                        surface_file.py
    .pvd .gif           from rest to load                  time_series.py, movie.py
    .inp .feb           the whole model, for CalculiX      calculix.py, febio.py
                        (or Abaqus) and for FEBio

`solver_model.py` describes the model for both other solvers.
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
