"""Every format that a solved body can be written in, by suffix."""

from collections.abc import Iterable
from pathlib import Path

from palpate.service.export.calculix import export_calculix
from palpate.service.export.febio import export_febio
from palpate.service.export.mesh_file import export_solved_mesh
from palpate.service.export.solved_body import SolvedBody
from palpate.service.export.solver_model import comparable, solver_model
from palpate.service.export.stored import TISSUE_NAMES, export_volume
from palpate.service.export.suffixes import SOLVER_SUFFIXES, SURFACE_SUFFIXES, VOLUME_SUFFIXES
from palpate.service.export.surface_file import export_surface
from palpate.workers.body.mesh.boundary import boundary_triangles


def export_solved(paths: Iterable[Path], body: SolvedBody, *, as_told: bool = False) -> SolvedBody:
    """Write a solved body to files, each in the format of its suffix.

    Parameters
    ----------
    paths : iterable of Path
    body : SolvedBody
    as_told : bool
        Show in all files the `comparable` solution, which other solvers are told.

    Returns
    -------
    SolvedBody
        The solution that meshes, surfaces and labels show.

    Raises
    ------
    InputError
        If a suffix is not known, or the body cannot be solved as another solver would.
    StoreError
        If the file system refuses.
    """
    paths = list(paths)
    other = any(path.suffix.lower() in SOLVER_SUFFIXES for path in paths)
    told = body.under(comparable(body.solved.problem)) if other or as_told else body
    shown = told if as_told else body
    for path in paths:
        suffix = path.suffix.lower()
        if suffix in SOLVER_SUFFIXES:
            write = export_calculix if suffix == ".inp" else export_febio
            write(path, solver_model(body, told))
        elif suffix in SURFACE_SUFFIXES:
            triangles = boundary_triangles(shown.level.model.elements.tets)
            export_surface(path, shown.positions_mm, triangles)
        elif suffix in VOLUME_SUFFIXES:
            export_volume(path, shown.deformed_labels(), TISSUE_NAMES)
        else:
            export_solved_mesh(path, shown)
    return shown
