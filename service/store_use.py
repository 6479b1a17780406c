"""What of a store the studies use, and what can go."""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from service.study_log import read_study
from storage.atomic import discard, is_temporary, temporary_sibling
from storage.errors import StoreError
from storage.layout import StudyLayout
from storage.stores import Store
from storage.volumes import volume_meta

DAY_S = 86_400.0


@dataclass(frozen=True)
class StudyUse:
    """Digests that one study needs, by folder of the store."""

    volumes: frozenset[str]
    meshes: frozenset[str]
    fields: frozenset[str]
    evaluations: frozenset[str]

    def paths(self, store: Store) -> list[Path]:
        """Return where they lie, as far as they are there."""
        layout = store.layout
        wanted = [
            *(layout.volume(name) for name in sorted(self.volumes)),
            *(layout.mesh(name) for name in sorted(self.meshes)),
            *(layout.field(name) for name in sorted(self.fields)),
            *(layout.evaluation(name) for name in sorted(self.evaluations)),
        ]
        return [path for path in wanted if path.exists()]


def study_use(folder: Path) -> StudyUse:
    """Return what a study needs: bodies, mesh, and all its evaluations.

    Raises
    ------
    InputError
        If there is no study.
    """
    _, log = read_study(folder)
    volumes, meshes = set(), set()
    for session in log.sessions:
        volumes |= {session.prepared["volume"], session.target["target"]}
        meshes.add(session.prepared["mesh"])
    evaluated = frozenset(record.digest for record in log.endings.values())
    return StudyUse(frozenset(volumes) | evaluated, frozenset(meshes), evaluated, evaluated)


def studies_in(folders: Iterable[Path]) -> list[Path]:
    """Return all studies at or below some folders."""
    found = []
    for folder in folders:
        if StudyLayout(folder).journal.is_file():
            found.append(folder)
        elif folder.is_dir():
            found += [one for one in sorted(folder.iterdir()) if StudyLayout(one).journal.is_file()]
    return found


@dataclass(frozen=True)
class Garbage:
    """What no study needs.

    Parameters
    ----------
    paths : list of Path
    size_bytes : int
    """

    paths: list[Path]
    size_bytes: int


def find_garbage(
    store: Store, uses: Iterable[StudyUse], *, older_than_days: float, images: bool = False
) -> Garbage:
    """Find what none of the studies needs and nobody has touched for some days.

    Parameters
    ----------
    uses : iterable of StudyUse
        Of all studies that are to be kept.
    older_than_days : float
        Younger entries stay: a run may just be making use of them.
    images : bool
        Imported images, too; nobody can make them again.
    """
    kept = {path for use in uses for path in use.paths(store)}
    oldest = time.time() - older_than_days * DAY_S
    paths = []
    for folder in store.layout.folders:
        for entry in sorted(folder.iterdir()):
            if entry in kept or is_temporary(entry) or entry.stat().st_mtime > oldest:
                continue
            if folder == store.layout.volumes and not images and _is_imported(store, entry):
                continue
            paths.append(entry)
    return Garbage(paths, sum(_size(path) for path in paths))


def remove(garbage: Garbage) -> None:
    """Remove it, records of evaluations first: they vouch for the rest.

    Raises
    ------
    StoreError
        If the file system refuses.
    """
    for path in sorted(garbage.paths, key=lambda path: path.suffix != ".json"):
        aside = temporary_sibling(path)
        try:
            path.rename(aside)
        except FileNotFoundError:
            continue
        except OSError as error:
            raise StoreError(f"{path} cannot be removed: {error.strerror}.") from error
        discard(aside)


def _is_imported(store: Store, entry: Path) -> bool:
    try:
        return "name" in volume_meta(store, entry.stem)
    except StoreError:
        return True  # damaged: `palpate store check` decides


def _size(path: Path) -> int:
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
