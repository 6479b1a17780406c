"""Stored data that studies still need, and data that can be deleted."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.service.study.study_folder import read_study
from palpate.storage.backends.store_paths import Place, StudyLayout
from palpate.storage.errors import InputError, StoreError
from palpate.storage.store import Store
from palpate.storage.stored_arrays import named_volumes, volume_meta

DAY_S = 86_400.0


@dataclass(frozen=True)
class StudyUse:
    """Data needed by one study: digests by folder of the store, and volumes named in its file."""

    volumes: frozenset[str]
    meshes: frozenset[str]
    fields: frozenset[str]
    evaluations: frozenset[str]
    named: frozenset[str] = frozenset()

    def places(self, store: Store) -> list[Place]:
        """Return the locations of the data, whether or not they exist."""
        layout = store.layout
        return [
            *(layout.volume(name) for name in sorted(self.volumes)),
            *(layout.mesh(name) for name in sorted(self.meshes)),
            *(layout.field(name) for name in sorted(self.fields)),
            *(layout.evaluation(name) for name in sorted(self.evaluations)),
        ]


def study_use(folder: Path) -> StudyUse:
    """Return the data that a study needs: bodies, mesh, and all its evaluations.

    Raises
    ------
    InputError
        If there is no study.
    """
    study, log = read_study(folder)
    volumes, meshes = set(), set()
    for session in log.sessions:
        volumes |= {session.prepared["volume"], session.target["target"]}
        meshes.add(session.prepared["mesh"])
    evaluated = frozenset(record.digest for record in log.endings.values())
    return StudyUse(
        frozenset(volumes) | evaluated,
        frozenset(meshes),
        evaluated,
        evaluated,
        frozenset(_volumes_named(study.spec)),
    )


def _volumes_named(spec: object) -> Iterator[str]:
    """Yield the volumes in a study file, at any depth: paths, names or digests."""
    for key, value in spec.items() if isinstance(spec, Mapping) else ():
        if key == "volume" and isinstance(value, str):
            yield value
        yield from _volumes_named(value)


def studies_in(folders: Iterable[Path]) -> list[Path]:
    """Return all studies in some folders and their subfolders."""
    found = []
    for folder in folders:
        if StudyLayout(folder).journal.is_file():
            found.append(folder)
        elif folder.is_dir():
            found += [one for one in sorted(folder.iterdir()) if StudyLayout(one).journal.is_file()]
    return found


@dataclass(frozen=True)
class NamedVolume:
    """A named volume and the studies that need it.

    Parameters
    ----------
    name, digest : str
    studies : tuple of Path
        Folders of studies.
    """

    name: str
    digest: str
    studies: tuple[Path, ...]


def find_named(store: Store, names: Sequence[str], folders: Iterable[Path]) -> list[NamedVolume]:
    """Return the volumes with these names, and the studies in some folders that need them.

    Raises
    ------
    InputError
        If there is no volume of a given name.
    StoreError
        If the journal of a study is damaged.
    """
    known = named_volumes(store)
    if unknown := [name for name in names if name not in known]:
        there = ", ".join(sorted(known)) or "none"
        raise InputError(
            f"The store {store} has no volume named {', '.join(unknown)}. Names in it: {there}."
        )
    uses = [(folder, study_use(folder)) for folder in folders]
    return [
        NamedVolume(name, digest, tuple(f for f, use in uses if _needs(use, name, digest)))
        for name in dict.fromkeys(names)
        for digest in known[name]
    ]


def refuse_if_needed(volumes: Iterable[NamedVolume]) -> None:
    """Raise an error if studies need these volumes.

    Raises
    ------
    InputError
        If a study needs one; the message names each volume with its studies.
    """
    needed = [v for v in volumes if v.studies]
    if needed:
        lines = "; ".join(f"{v.name} by {', '.join(map(str, v.studies))}" for v in needed)
        raise InputError(
            f"Studies need these volumes: {lines}. Without them the studies can be read, but not "
            "continued, drawn or diagnosed. Nothing was removed; to remove them anyway, add "
            "--force."
        )


def _needs(use: StudyUse, name: str, digest: str) -> bool:
    return digest in use.volumes or bool({name, digest} & use.named)


@dataclass(frozen=True)
class Garbage:
    """Data that no study needs.

    Parameters
    ----------
    paths : list of Path or ObjectPath
    size_bytes : int
    """

    paths: list[Place]
    size_bytes: int


def find_garbage(
    store: Store, uses: Iterable[StudyUse], *, older_than_days: float, images: bool = False
) -> Garbage:
    """Return the data that no study needs and that have not changed for some days.

    Parameters
    ----------
    uses : iterable of StudyUse
        Uses of all studies to keep.
    older_than_days : float
        Newer entries are kept: a run may be using them.
    images : bool
        Whether to include imported images, which cannot be recomputed.
    """
    kept = {place for use in uses for place in use.places(store)}
    oldest = time.time() - older_than_days * DAY_S
    day_ago = time.time() - DAY_S
    paths = []
    for folder in store.layout.folders:
        for entry in store.backend.entries(folder):
            if entry.half_written:  # and abandoned, since no write takes a day
                paths += [entry.place] if entry.modified_s < day_ago else []
                continue
            if entry.place in kept or entry.modified_s > oldest:
                continue
            if folder == store.layout.volumes and not images and _is_imported(store, entry.place):
                continue
            paths.append(entry.place)
    return Garbage(paths, sum(store.backend.size_bytes(path) for path in paths))


def remove(store: Store, garbage: Garbage) -> None:
    """Remove data, evaluation records first, as they mark the rest as complete.

    Raises
    ------
    StoreError
        If the store cannot be written.
    """
    for path in sorted(garbage.paths, key=lambda path: path.suffix != ".json"):
        store.backend.remove(path)


def _is_imported(store: Store, entry: Place) -> bool:
    try:
        return "name" in volume_meta(store, entry.stem)
    except StoreError:
        return True  # damaged: left to `palpate store check`
