"""The three bodies of a study, as far as its store still has them.

They are the undeformed body, the target and the best candidate. The report names missing bodies and
omits their pictures.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.service.report.study.surfaces import StudySurface, study_surfaces
from palpate.service.study.spec import StudySpec
from palpate.storage.backends.places import place_of
from palpate.storage.errors import PalpateError
from palpate.storage.records.record import SessionRecord
from palpate.storage.records.tasks import Scores
from palpate.storage.stores.fields import has_field, load_field
from palpate.storage.stores.meshes import has_mesh
from palpate.storage.stores.store import open_store
from palpate.storage.values import FloatArray, TetMesh, Tissue, Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.comparison.warp.displacement_image import displacement_image
from palpate.workers.organs.organ import scores_by_part
from palpate.workers.organs.registry import findings_of, organ_named, organ_plugin
from palpate.workers.tasks.body_store import BodyStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        A sentence; see `workers.organs.organ.Organ`.
    surfaces : tuple of StudySurface
        Surfaces of a three-dimensional body; empty if not requested.
    displacement : Volume or None
        Length of the displacement in the best candidate in mm, nan outside the body.
    figures : callable
        Maps findings to their figures; see `workers.organs.registry.Findings`.
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
    reference = _stored(bodies, session.prepared.get("volume"), "undeformed body", missing)
    target = _stored(bodies, session.target.get("target"), "target", missing)
    explained = None
    if best is None:
        missing.append("No candidate has a score yet, so there is no best candidate to show.")
    else:
        explained = _explained(bodies, session, best, reference, target, missing)

    more = findings_of(spec.case.organ)

    def scores(body: Any | None) -> Mapping[str, Scores]:
        if body is None or target is None or not compare:
            return {}
        return scores_by_part(organ, target, body, spec.score)

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
        surfaces=_surfaces(bodies, session, best, reference, target) if in_3d else (),
        displacement=_displacement(bodies, session, best, explained) if in_3d else None,
        figures=_no_figures
        if more is None
        else partial(more.figures, spec, (reference, target, explained)),
    )


def _surfaces(
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


def _displacement(
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


def _stored(bodies: BodyStore, digest: str | None, what: str, missing: list[str]) -> Any | None:
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


def _explained(
    bodies: BodyStore,
    session: SessionRecord,
    best: str,
    reference: Any | None,
    target: Any | None,
    missing: list[str],
) -> Any | None:
    """Return the best candidate's deformed body, stored or recomputed from its displacements."""
    if bodies.has_body(best):
        return _stored(bodies, best, "best candidate", missing)
    store, mesh = bodies.store, session.prepared.get("mesh")
    if reference is None or not mesh or not (has_mesh(store, mesh) and has_field(store, best)):
        return _stored(bodies, None, "best candidate", missing)
    try:
        displacement_mm = load_field(store, best)
        return bodies.organ.deform(reference, bodies.mesh(mesh), displacement_mm, target)
    except PalpateError as error:
        missing.append(f"The best candidate's volume cannot be recomputed: {error}")
        return None
