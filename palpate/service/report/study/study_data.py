"""The data of a study's page: its journal, results, bodies and their surfaces.

The bodies are the undeformed body, the target and the best candidate, as far as the store still has
them. The report names missing bodies and omits their pictures. Surfaces are shown at rest, under
load, and with their distance from the target.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import place_of
from palpate.storage.errors import InputError, PalpateError
from palpate.storage.journal_records import EvaluationRecord, SessionRecord
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import has_field, has_mesh, load_field
from palpate.storage.values import FloatArray, IntArray, Scores, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    Interface,
    signed_distance,
)
from palpate.workers.comparison.warp_volume import displacement_image
from palpate.workers.diagnosis.problem.prepared_parts import shape
from palpate.workers.organs.organ_plugins import findings_of, organ_named, organ_plugin
from palpate.workers.tasks.task_store import BodyStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STUDY_INTERFACES: Sequence[Interface] = (OUTLINE, GLANDULAR)
# Points this close to the chest wall are where the image was cut, not on an interface.
WALL_MARGIN_MM = 3.0
# Larger distances are drawn as this one.
LARGEST_DISTANCE_MM = 12.0


@dataclass(frozen=True, eq=False)
class StudySurface:
    """One interface of a study's body.

    Parameters
    ----------
    name : str
    vertices : ndarray, shape (n, 3)
        At rest, in mm.
    triangles : ndarray of int32, shape (m, 3)
    moved : ndarray, shape (n, 3), or None
        Positions under load for the best candidate.
    gap_mm : ndarray, shape (n,), or None
        Distance from the interface of the target, positive outside; nan at the chest wall.
    """

    name: str
    vertices: FloatArray
    triangles: IntArray
    moved: FloatArray | None = None
    gap_mm: FloatArray | None = field(default=None)


def study_surfaces(
    reference: Volume,
    mesh: TetMesh | None,
    displacement_mm: FloatArray | None,
    target: Volume | None,
) -> tuple[StudySurface, ...]:
    """Return the outlines of a body and of its gland, if they exist.

    Parameters
    ----------
    reference : Volume
        `Tissue` labels at rest.
    mesh : TetMesh or None
        Mesh of n nodes.
    displacement_mm : ndarray, shape (n, 3), or None
        Displacement of the best candidate.
    target : Volume or None
        `Tissue` labels of the target.
    """
    surfaces = []
    reference = _in_air(reference)
    for interface in STUDY_INTERFACES:
        try:
            drawn = shape(reference, interface.inside)
        except InputError:
            continue  # the tissue is missing or too small
        moved = gap = None
        if mesh is not None and displacement_mm is not None:
            try:
                moved = (
                    drawn.vertices + interpolation_at_points(mesh, drawn.vertices) @ displacement_mm
                )
            except InputError:
                moved = None  # the mesh belongs to another body
        if moved is not None and target is not None:
            gap = _distance_from_target(interface, drawn.vertices, moved, target)
        surfaces.append(StudySurface(interface.name, drawn.vertices, drawn.triangles, moved, gap))
    return tuple(surfaces)


def _in_air(labels: Volume) -> Volume:
    """Return a body padded with air except below the chest wall, to close its surface."""
    around = ((0, 1), (1, 1), (1, 1))
    (dx, dy, _), (x, y, z) = labels.spacing_mm, labels.origin_mm
    values = np.pad(labels.values, around)
    return replace(labels, values=values, origin_mm=(x - dx, y - dy, z))


def _distance_from_target(
    interface: Interface, rest: FloatArray, moved: FloatArray, target: Volume
) -> FloatArray | None:
    try:
        observed = signed_distance(_in_air(target), interface.inside, band_mm=LARGEST_DISTANCE_MM)
        apart, _ = observed.at(moved)
    except InputError:
        return None
    at_wall = rest[:, 2] < rest[:, 2].min() + WALL_MARGIN_MM
    unknown = at_wall | (np.abs(apart) >= LARGEST_DISTANCE_MM)
    return np.asarray(np.where(unknown, np.nan, apart))


TISSUE_NAMES = {int(tissue): tissue.name.lower() for tissue in Tissue if tissue}


def _no_figures(findings: Mapping[str, Any]) -> "Iterable[tuple[Figure, str]]":
    return ()


@dataclass(frozen=True, eq=False)
class Bodies:
    """The available bodies, and a sentence for each missing one.

    Parameters
    ----------
    reference, target, best : Volume or None
        The undeformed body, the target and the deformed body of the best candidate.
    missing : tuple of str
        Sentences for the reader.
    scores_before, scores_after : mapping of str to Scores
        Scores of the undeformed and of the best body by part; empty if a body is missing.
    labels : mapping of int to str
        Meaning of the numbers in the pictures.
    load_direction : str
        A sentence; see `workers.organs.organ_protocol.Organ`.
    surfaces : tuple of StudySurface
        Surfaces of a three-dimensional body; empty if not requested.
    displacement : Volume or None
        Length of the displacement in the best candidate in mm, nan outside the body.
    figures : callable
        Maps findings to their figures; see `workers.organs.organ_plugins.Findings`.
    """

    reference: Volume | None = None
    target: Volume | None = None
    best: Volume | None = None
    missing: tuple[str, ...] = ()
    scores_before: Mapping[str, Scores] = field(default_factory=dict)
    scores_after: Mapping[str, Scores] = field(default_factory=dict)
    labels: Mapping[int, str] = field(default_factory=lambda: TISSUE_NAMES)
    load_direction: str = ""
    surfaces: tuple[StudySurface, ...] = ()
    displacement: Volume | None = None
    figures: Callable[[Mapping[str, Any]], "Iterable[tuple[Figure, str]]"] = _no_figures


def find_bodies(
    study: Path,
    spec: StudySpec,
    session: SessionRecord | None,
    best: str | None,
    compare: bool,
    in_3d: bool = True,
) -> Bodies:
    """Read the bodies from the store.

    Parameters
    ----------
    study : Path
        Folder of the study; a store that was moved with it is found next to it.
    spec : StudySpec
    session : SessionRecord or None
        The last run of the study; None if its preparation was never completed.
    best : str or None
        Digest of the best evaluation.
    compare : bool
        Whether to score the bodies; a completed study has these scores already.
    in_3d : bool
        Whether to compute surfaces, which takes one or two seconds.
    """
    if session is None:
        return Bodies(missing=("The body and its target have not been prepared yet.",))
    try:
        noted = place_of(session.store)
        moved = isinstance(noted, Path) and not noted.is_dir()
        store = open_store(study.parent / "store" if moved else noted, create=False)
    except PalpateError as error:
        return Bodies(missing=(f"The store cannot be read, so there are no pictures: {error}",))
    organ = organ_named(spec.case.organ)
    bodies = BodyStore(store, organ)
    missing: list[str] = []
    reference = _stored_volume(bodies, session.prepared.get("volume"), "undeformed body", missing)
    target = _stored_volume(bodies, session.target.get("target"), "target", missing)
    explained = None
    if best is None:
        missing.append("No candidate has a score yet, so there is no best candidate to show.")
    else:
        explained = _best_body(bodies, session, best, reference, target, missing)

    more = findings_of(spec.case.organ)

    def scores(body: Any | None) -> Mapping[str, Scores]:
        if body is None or target is None or not compare:
            return {}
        return organ.scores_by_part(target, body, spec.score)

    def picture(body: Any | None) -> Volume | None:
        return None if body is None else organ.picture(body)

    return Bodies(
        picture(reference),
        picture(target),
        picture(explained),
        tuple(missing),
        scores(reference),
        scores(explained),
        organ.picture_labels,
        organ_plugin(spec.case.organ).load_direction,
        surfaces=_surfaces_of_best(bodies, session, best, reference, target) if in_3d else (),
        displacement=_displacement_of_best(bodies, session, best, explained) if in_3d else None,
        figures=_no_figures
        if more is None
        else partial(more.figures, spec, (reference, target, explained)),
    )


def _surfaces_of_best(
    bodies: BodyStore,
    session: SessionRecord,
    best: str | None,
    reference: Any | None,
    target: Any | None,
) -> tuple[StudySurface, ...]:
    """Return the surfaces of a three-dimensional body, moved by the best candidate."""
    if not isinstance(reference, Volume) or 1 in reference.values.shape:
        return ()
    tets, displacement_mm = _moved_mesh(bodies, session, best) or (None, None)
    observed = target if isinstance(target, Volume) else None
    return study_surfaces(reference, tets, displacement_mm, observed)


def _displacement_of_best(
    bodies: BodyStore, session: SessionRecord, best: str | None, explained: Any | None
) -> Volume | None:
    """Return the displacement of the best candidate, on voxels of twice the size."""
    moved = _moved_mesh(bodies, session, best)
    if moved is None or not isinstance(explained, Volume) or 1 in explained.values.shape:
        return None
    dx, dy, dz = explained.spacing_mm
    coarse = replace(explained, spacing_mm=(2 * dx, 2 * dy, 2 * dz))
    return displacement_image(*moved, coarse)


def _moved_mesh(
    bodies: BodyStore, session: SessionRecord, best: str | None
) -> tuple[TetMesh, FloatArray] | None:
    """Return the mesh and the displacements of the best candidate, if the store has them."""
    store, digest = bodies.store, session.prepared.get("mesh")
    if best is None or not digest or not (has_mesh(store, digest) and has_field(store, best)):
        return None
    try:
        mesh, displacement_mm = bodies.mesh(digest), load_field(store, best)
    except PalpateError:
        return None
    return (mesh.finest.mesh, displacement_mm) if isinstance(mesh, Hierarchy) else None


def _stored_volume(
    bodies: BodyStore, digest: str | None, what: str, missing: list[str]
) -> Any | None:
    if digest is None or not bodies.has_body(digest):
        missing.append(
            f"The volume of the {what} is no longer in the store; running the study again "
            "restores it."
        )
        return None
    try:
        return bodies.body(digest)
    except PalpateError as error:
        missing.append(f"The volume of the {what} cannot be read: {error}")
        return None


def _best_body(
    bodies: BodyStore,
    session: SessionRecord,
    best: str,
    reference: Any | None,
    target: Any | None,
    missing: list[str],
) -> Any | None:
    """Return the best candidate's deformed body, stored or recomputed from its displacements."""
    if bodies.has_body(best):
        return _stored_volume(bodies, best, "best candidate", missing)
    store, mesh = bodies.store, session.prepared.get("mesh")
    if reference is None or not mesh or not (has_mesh(store, mesh) and has_field(store, best)):
        return _stored_volume(bodies, None, "best candidate", missing)
    try:
        displacement_mm = load_field(store, best)
        return bodies.organ.deform(reference, bodies.mesh(mesh), displacement_mm, target)
    except PalpateError as error:
        missing.append(f"The best candidate's volume cannot be recomputed: {error}")
        return None


@dataclass(frozen=True, eq=False)
class StudyData:
    """The data of a study.

    Parameters
    ----------
    results : StudyResults
        Results so far.
    endings : tuple of EvaluationRecord
        Endings of all candidates so far.
    sessions : tuple of SessionRecord
        All runs.
    bodies : Bodies
        Volumes still in the store.
    quick : bool
        Whether the page is written during the search, without slow parts.
    """

    results: StudyResults
    endings: tuple[EvaluationRecord, ...] = ()
    sessions: tuple[SessionRecord, ...] = ()
    bodies: Bodies = field(default_factory=Bodies)
    quick: bool = False

    @property
    def session(self) -> SessionRecord | None:
        """Return the last run; None if preparation was never completed."""
        return self.sessions[-1] if self.sessions else None


def read_study_data(study_dir: Path, *, quick: bool = False) -> StudyData:
    """Read journal, results and volumes of a study.

    Parameters
    ----------
    study_dir : Path
    quick : bool
        Skip parts that take more than 0.1 s: surfaces in three dimensions, and scores that are
        not in the journal.

    Raises
    ------
    InputError
        If there is no study in the folder.
    StoreError
        If its journal is damaged.
    """
    results = study_results(study_dir)
    _, log = read_study(study_dir)
    best = None if results.best is None else results.best.digest
    unscored = log.end is None and not quick
    bodies = find_bodies(
        study_dir, results.spec, log.last_session, best, compare=unscored, in_3d=not quick
    )
    canonical = results.spec.case.canonical
    endings = tuple(replace(r, genes=canonical(r.genes)) for r in log.endings.values())
    return StudyData(results, endings, log.sessions, bodies, quick)
