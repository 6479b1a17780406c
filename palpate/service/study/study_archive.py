"""A study as one file: its folder and the parts of its store needed to continue elsewhere.

::

    palpate-study.json          schema version, name, and the SHA-256 of every other member
    study/study.yaml ...        files of the study's folder
    store/volumes/<digest>.zarr/...  as in a store

The archive is an ordinary tar file. Only plain files with the names of a study are extracted, and
the content of each is verified. Archives are not signed: import only those you trust.
"""

import hashlib
import io
import re
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from palpate.service.installed_packages import versions
from palpate.service.study.store_use import study_use
from palpate.service.study.study_folder import StudyLog, read_study
from palpate.storage.backends.atomic_files import (
    discard,
    explained,
    is_temporary,
    publishing,
    replacing,
    temporary_sibling,
)
from palpate.storage.backends.folder_backend import entries
from palpate.storage.backends.store_paths import Location, StudyLayout
from palpate.storage.errors import InputError, StoreError
from palpate.storage.journal import Journal
from palpate.storage.json_digests import dumps, loads
from palpate.storage.store import Store, check_schema, open_store
from palpate.storage.stored_arrays import copy_entry, local_copy
from palpate.workers.input_files import check_regular

SCHEMA_VERSION = 1
MANIFEST = "palpate-study.json"
MOST_MANIFEST_BYTES = 256 * 2**20
STUDY_FILES = ("study.yaml", "journal.jsonl", "findings.json", "report.html")
BLOCK_BYTES = 2**20

_PART = r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}"
_MEMBER = re.compile(
    rf"study/({'|'.join(re.escape(name) for name in STUDY_FILES)})"
    rf"|store/(volumes|meshes|fields)/{_PART}\.zarr(/{_PART})+"
    rf"|store/evaluations/{_PART}\.json"
)


@dataclass(frozen=True)
class Archived:
    """The contents of an archive.

    Parameters
    ----------
    name : str
        Name of the study.
    files : int
    size_bytes : int
    """

    name: str
    files: int
    size_bytes: int


def export_study(folder: Path, archive: Path) -> Archived:
    """Write a study and everything it needs into one file.

    Raises
    ------
    InputError
        If there is no study, or it has not run yet.
    StoreError
        If its store is missing, the study is running, or the archive cannot be written.
    """
    study, log = read_study(folder)
    if log.last_session is None:
        raise InputError(f"{folder} has not run yet: there is nothing to export but its file.")
    if Journal.is_being_written(StudyLayout(folder).journal):
        raise StoreError(f"{folder} is running: export it after it has stopped.")
    store = open_store(log.last_session.store, create=False)
    name = str(study.spec["name"])
    manifest = {"schema_version": SCHEMA_VERSION, "study": name, "versions": versions()}
    written = datetime.fromtimestamp(StudyLayout(folder).journal.stat().st_mtime, UTC)
    manifest["last_run_s"] = log.last_run_s(written)
    with explained(archive), _scratch_beside(archive) as scratch:
        members = list(_members(folder, store, scratch))
        hashes = {member: _sha256(path) for member, path in members}
        text = dumps(manifest | {"sha256": hashes}).encode()
        with replacing(archive) as temporary, tarfile.open(temporary, "w") as tar:
            _add(tar, MANIFEST, io.BytesIO(text), len(text))
            for member, path in members:
                with path.open("rb") as file:
                    _add(tar, member, file, path.stat().st_size)
        return Archived(name, len(members), sum(path.stat().st_size for _, path in members))


def import_study(archive: Path, folder: Path, location: Location) -> Archived:
    """Unpack a study, so that it can be read, diagnosed and continued.

    Parameters
    ----------
    folder : Path
        Folder of the study; must not exist.
    location : str or Path
        The store that receives the study's data; existing data are kept.

    Raises
    ------
    InputError
        If `folder` exists.
    StoreError
        If the archive is damaged or does not contain a study, or a file cannot be written.
    """
    folder = folder.expanduser().absolute()
    if folder.exists():
        raise InputError(f"{folder} exists: choose another place with --study.")
    store = open_store(location)
    with _reading(archive) as tar:
        manifest = _manifest(tar, archive)
        with explained(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with _scratch_beside(folder) as parts, publishing(folder) as unpacked:
                unpacked.mkdir()
                places = {"study": unpacked, "store": parts}
                size = _unpack(tar, manifest["sha256"], places, archive)
                _say_where_the_store_is(unpacked, store, manifest.get("last_run_s"))
                _publish_store(parts, store)
    return Archived(str(manifest["study"]), len(manifest["sha256"]), size)


def archived_name(archive: Path) -> str:
    """Return the name of the study in an archive.

    Raises
    ------
    InputError
        If the file does not exist.
    StoreError
        If it is not an archive of a study.
    """
    with _reading(archive) as tar:
        return str(_manifest(tar, archive)["study"])


@contextmanager
def _reading(archive: Path) -> Iterator[tarfile.TarFile]:
    check_regular(archive)
    try:
        with tarfile.open(archive, "r:") as tar:
            yield tar
    except FileNotFoundError as error:
        raise InputError(f"There is no archive {archive}.") from error
    except IsADirectoryError as error:
        raise InputError(f"{archive} is a folder, expected an archive.") from error
    except (tarfile.TarError, EOFError) as error:
        raise _damaged(archive, str(error)) from error


def _members(folder: Path, store: Store, scratch: Path) -> Iterator[tuple[str, Path]]:
    for name in STUDY_FILES:
        if (folder / name).is_file():
            yield f"study/{name}", folder / name
    wanted = set(study_use(folder).places(store))
    for part in store.layout.folders:
        present = [entry.place for entry in store.backend.entries(part) if entry.place in wanted]
        for path in (local_copy(place, scratch) for place in present):
            inside = f"store/{part.name}/{path.name}"
            if path.is_file():
                yield inside, path
                continue
            for file in sorted(path.rglob("*")):
                if file.is_file() and not is_temporary(file):
                    yield f"{inside}/{file.relative_to(path).as_posix()}", file


def _add(tar: tarfile.TarFile, name: str, file: Any, size: int) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o644
    tar.addfile(member, file)


def _manifest(tar: tarfile.TarFile, archive: Path) -> dict[str, Any]:
    first = tar.next()
    if first is None or first.name != MANIFEST or first.size > MOST_MANIFEST_BYTES:
        raise _damaged(archive, f"it does not begin with {MANIFEST}")
    file = tar.extractfile(first)
    try:
        manifest: dict[str, Any] = loads(file.read() if file else b"")
        check_schema(manifest["schema_version"], SCHEMA_VERSION, archive)
        hashes = manifest["sha256"]
        if not all(_MEMBER.fullmatch(name) and isinstance(hashes[name], str) for name in hashes):
            raise ValueError("it contains files that do not belong to a study")
        if not re.fullmatch(_PART, manifest["study"]):
            raise ValueError("it does not name a study")
        if not isinstance(manifest.get("last_run_s"), float | int | None):
            raise ValueError("it does not say how long its study ran")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _damaged(archive, str(error)) from error
    return manifest


@contextmanager
def _scratch_beside(path: Path) -> Iterator[Path]:
    """Provide a scratch folder on the same disk as `path`."""
    folder = temporary_sibling(path)
    folder.mkdir()
    try:
        yield folder
    finally:
        discard(folder)


def _unpack(
    tar: tarfile.TarFile, hashes: dict[str, str], places: dict[str, Path], archive: Path
) -> int:
    missing, size = dict(hashes), 0
    while (member := tar.next()) is not None:
        expected = missing.pop(member.name, None)
        file = tar.extractfile(member) if member.isreg() else None
        if expected is None or file is None:
            raise _damaged(archive, f"{member.name[:80]!r} does not belong in it")
        kind, *parts = PurePosixPath(member.name).parts
        path = places[kind].joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        state = hashlib.sha256()
        with path.open("xb") as out:
            while block := file.read(BLOCK_BYTES):
                state.update(block)
                size += len(block)
                out.write(block)
        if state.hexdigest() != expected:
            raise _damaged(archive, f"the content of {member.name} has changed")
    if missing:
        raise _damaged(archive, f"{next(iter(missing))} is missing")
    return size


def _say_where_the_store_is(folder: Path, store: Store, last_run_s: float | None) -> None:
    """Add a session to the journal: readers of the study find its store there."""
    log = StudyLog.read(StudyLayout(folder).journal)
    if log.last_session is None:
        raise StoreError("The study in the archive has never run.")
    now = datetime.now(UTC).isoformat(timespec="seconds")
    moved = replace(
        log.last_session,
        began=now,
        store=str(store.root),
        seconds=0.0,
        previous_run_s=None if last_run_s is None else float(last_run_s),
    )
    with Journal(StudyLayout(folder).journal) as journal:
        journal.append(moved.to_json())


def _publish_store(parts: Path, store: Store) -> None:
    """Copy missing data to the store; evaluation records last, as they mark the rest complete."""
    for folder in store.layout.folders:
        for entry in entries(parts / folder.name):
            copy_entry(entry.place, folder / entry.place.name)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _damaged(archive: Path, why: str) -> StoreError:
    return StoreError(
        f"{archive} is not an archive of a study, or is damaged: {why}. Create it again with "
        "`palpate store export`."
    )
