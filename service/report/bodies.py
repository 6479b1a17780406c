"""The three bodies of a study, as far as its store still has them.

The undeformed body, the target, and the target as the best candidate explains it.
What is missing is said in words; a report without pictures is still a report.
"""

from dataclasses import dataclass
from pathlib import Path

from service.chronicle import Session
from storage.errors import PalpateError
from storage.fields import has_field, load_field
from storage.meshes import has_mesh, load_mesh
from storage.stores import Store, open_store
from storage.values import Volume
from storage.volumes import has_volume, load_volume
from workers import pipeline
from workers.mesh.hierarchy import from_arrays
from workers.similarity.score import Surface


@dataclass(frozen=True, eq=False)
class Bodies:
    """Volumes that were found, and a sentence for each that was not.

    Parameters
    ----------
    reference, target, best : Volume or None
        The undeformed body, the deformed one that is explained, and the explanation.
    missing : tuple of str
        Sentences for the reader.
    """

    reference: Volume | None = None
    target: Volume | None = None
    best: Volume | None = None
    missing: tuple[str, ...] = ()

    def scores(self, candidate: Volume | None, surface: Surface) -> dict[str, dict[str, float]]:
        """Score `candidate` against the target tissue by tissue; empty if a volume is missing."""
        if candidate is None or self.target is None:
            return {}
        return pipeline.score_by_tissue(self.target, candidate, surface)


def find_bodies(study: Path, session: Session | None, best: str | None) -> Bodies:
    """Read what the store has.

    Parameters
    ----------
    study : Path
        Folder of the study; a store that was moved with it is found beside it.
    session : Session or None
        The last run of the study; None if its preparation was never finished.
    best : str or None
        Digest of the best evaluation.
    """
    if session is None:
        return Bodies(missing=("The body and its target have not been prepared yet.",))
    try:
        noted = Path(session.store)
        store = open_store(noted if noted.is_dir() else study.parent / "store", create=False)
    except PalpateError as error:
        return Bodies(missing=(f"The store cannot be read, so there are no pictures: {error}",))
    missing: list[str] = []
    reference = _stored(store, session.prepared.get("volume"), "undeformed body", missing)
    target = _stored(store, session.target.get("target"), "target", missing)
    explained = None
    if best is None:
        missing.append("No candidate has a score yet, so there is no best one to show.")
    else:
        explained = _explained(store, session, best, reference, target, missing)
    return Bodies(reference, target, explained, tuple(missing))


def _stored(store: Store, digest: str | None, what: str, missing: list[str]) -> Volume | None:
    if digest is None or not has_volume(store, digest):
        missing.append(
            f"The volume of the {what} is no longer in the store; running the study again "
            "brings it back."
        )
        return None
    try:
        return load_volume(store, digest)
    except PalpateError as error:
        missing.append(f"The volume of the {what} cannot be read: {error}")
        return None


def _explained(
    store: Store, session: Session, best: str, reference: Volume | None, target: Volume | None,
    missing: list[str],
) -> Volume | None:  # fmt: skip
    """The best candidate's deformed body: kept, or made again from its displacements."""
    if has_volume(store, best):
        return _stored(store, best, "best candidate", missing)
    mesh = session.prepared.get("mesh")
    if reference is None or not mesh or not (has_mesh(store, mesh) and has_field(store, best)):
        return _stored(store, None, "best candidate", missing)
    try:
        arrays, _ = load_mesh(store, mesh)
        finest = from_arrays(arrays).finest.mesh
        return pipeline.deform(reference, finest, load_field(store, best), target)
    except PalpateError as error:
        missing.append(f"The best candidate's volume cannot be made again: {error}")
        return None
