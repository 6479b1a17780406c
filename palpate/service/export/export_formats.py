"""File formats of a solved body, by suffix.

A distribution offers an `Exporter` as an entry point of the group ``palpate.exporters``, under the
suffix without its dot.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from palpate.service.export.calculix import export_calculix
from palpate.service.export.febio import export_febio
from palpate.service.export.solved_mesh_files import (
    SERIES_NOTE,
    SolvedBody,
    export_series,
    export_solved_mesh,
    export_surface,
)
from palpate.service.export.solver_model import comparable, solver_model
from palpate.service.export.stored_files import (
    TISSUE_NAMES,
    export_volume,
    solved_suffixes,
    suffix_of,
)
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.plugins import load


@dataclass(frozen=True, slots=True)
class Exporter:
    """A file format of a solved body.

    Parameters
    ----------
    write : callable
        Writes to a path, given the displayed solution and the body as it was solved. The two
        differ if the displayed solution is the simplified one.
    simplified : bool
        Whether the format needs the simplified model that other solvers can represent.
    note : str
        A remark for readers of the file, printed next to its name.
    """

    write: Callable[[Path, SolvedBody, SolvedBody], None]
    simplified: bool = False
    note: str = ""


def export_solved(paths: Iterable[Path], body: SolvedBody, *, as_told: bool = False) -> SolvedBody:
    """Write a solved body to files, each in the format of its suffix.

    Parameters
    ----------
    paths : iterable of Path
    body : SolvedBody
    as_told : bool
        Whether all files show the `comparable` solution, which other solvers can represent.

    Returns
    -------
    SolvedBody
        The solution in meshes, surfaces and labels.

    Raises
    ------
    InputError
        If a suffix is unknown, or the simplified body cannot be solved.
    StoreError
        If the file cannot be written.
    """
    exporters = [(path, exporter_of(path)) for path in paths]
    simplified = as_told or any(exporter.simplified for _, exporter in exporters)
    told = body.under(comparable(body.solved.problem)) if simplified else body
    shown = told if as_told else body
    for path, exporter in exporters:
        exporter.write(path, told if exporter.simplified else shown, body)
    return shown


def exporter_of(path: Path) -> Exporter:
    """Return the format for a file's suffix.

    Raises
    ------
    InputError
        If the suffix is unknown.
    """
    found: Exporter = load("exporters", suffix_of(path, solved_suffixes()).lstrip("."))
    return found


def _mesh(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_solved_mesh(path, shown)


def _surface(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_surface(path, shown.positions_mm, boundary_triangles(shown.level.model.elements.tets))


def _labels(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_volume(path, shown.deformed_labels(), TISSUE_NAMES)


def _series(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_series(path, shown)


def _movie(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    # Imports matplotlib, which no other format needs.
    from palpate.service.export.movie import export_movie

    export_movie(path, shown)


def _calculix(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_calculix(path, solver_model(body, shown))


def _febio(path: Path, shown: SolvedBody, body: SolvedBody) -> None:
    export_febio(path, solver_model(body, shown))


MESH = Exporter(_mesh)
SURFACE = Exporter(_surface)
LABELS = Exporter(_labels)
SERIES = Exporter(_series, note=SERIES_NOTE)
MOVIE = Exporter(_movie, note=SERIES_NOTE)
CALCULIX = Exporter(_calculix, simplified=True)
FEBIO = Exporter(_febio, simplified=True)
