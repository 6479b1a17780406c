"""Export of bodies to the files of other programs.

::

    .nrrd .seg.nrrd .nii .nii.gz    label volumes                       stored_files.py
    .vtu .vtk .msh                  meshes, with stress and strain      solved_mesh_files.py
    .stl .pvd                       the surface; from rest to load      solved_mesh_files.py
    .gif                            from rest to load                   movie.py
    .inp .feb                       the whole model, for CalculiX (or   calculix.py, febio.py
                                    Abaqus) and for FEBio

`solver_model.py` describes the model for both other solvers.
"""

from palpate.service.export.stored_files import (
    MESH_SUFFIXES,
    TISSUE_NAMES,
    VOLUME_SUFFIXES,
    check_suffix,
    export_stored_mesh,
    export_volume,
)

__all__ = [
    "MESH_SUFFIXES",
    "TISSUE_NAMES",
    "VOLUME_SUFFIXES",
    "check_suffix",
    "export_stored_mesh",
    "export_volume",
]
