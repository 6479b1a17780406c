"""What clients send, checked before it is kept or queued: YAML, uploads, studies; and the limits.

YAML and JSON have no aliases, no deep nesting and no paths. Aliases can expand a kilobyte of text
to gigabytes, and deep nesting exceeds the recursion limit of the parser; no study needs either.

Uploaded images and cases are written completely or not at all and never changed. A name is a
folder and a file in it. Readers only open files in the folder of an upload
(`workers.input_files`); a case with paths to other folders is refused here as well, so that
the error appears at once. Files are hashed, checked and synced in threads. Data written by running
uploads count towards the limits.
"""

import hashlib
import os
import re
import threading
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from anyio import to_thread

from palpate.service.server.jobs.home_and_tokens import checked_name
from palpate.service.study.study_keys import StudySpec, spec_from_keys
from palpate.storage.backends.atomic_files import (
    clean_leftovers,
    discard,
    explained,
    is_temporary,
    sync,
    temporary_sibling,
)
from palpate.storage.errors import InputError, PalpateError, StoreError
from palpate.storage.store import Store
from palpate.storage.stored_arrays import has_volume, list_volumes, volume_meta
from palpate.workers.body.images.nrrd_images import check_attached
from palpate.workers.body.images.tiff_images import check_one_file
from palpate.workers.input_files import is_too_deep, parse_yaml, yaml_problem

MIB = 2**20


@dataclass(frozen=True)
class Limits:
    """Limits of one service.

    Parameters
    ----------
    body_bytes : int
        Size of a request other than an upload.
    upload_bytes, uploads_bytes : int
        Size of one uploaded file, and of all uploads together.
    uploads_files : int
        Number of uploaded files.
    evaluations : int
        Number of evaluations in one study.
    population : int
        Number of candidates in one generation.
    open_streams : int
        Number of clients following events at once.
    waiting_jobs : int
        Number of jobs that have not ended.
    """

    body_bytes: int = 512 * 1024
    upload_bytes: int = 1024 * MIB
    uploads_bytes: int = 50 * 1024 * MIB
    uploads_files: int = 20_000
    evaluations: int = 500_000
    population: int = 20_000
    open_streams: int = 64
    waiting_jobs: int = 1000


MOST_EVENTS = 50_000
DEEPEST = 40
TOO_LARGE = "{} is nested too deeply or too long for a study."
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LEADS_OUT = re.compile(
    r"^\s*(/|~|[A-Za-z]:[\\/]|\\\\|[A-Za-z][A-Za-z0-9+.-]*://)|(^|[\\/])\.\.([\\/]|$)"
)


def parsed_text(text: str, where: str) -> Any:
    """Parse YAML, which includes JSON.

    Raises
    ------
    InputError
        If it is not valid YAML, or uses features that are not accepted.
    """
    try:
        _check_events(text, where)
    except yaml.YAMLError as error:
        if is_too_deep(error):
            raise InputError(TOO_LARGE.format(where)) from None
        raise InputError(f"{where} is not valid YAML: {yaml_problem(error, text)}.") from error
    return parse_yaml(text, where)


def _check_events(text: str, where: str) -> None:
    depth = 0
    for count, event in enumerate(yaml.parse(text, _LOADER)):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise InputError(f"{where} uses anchors or aliases (& and *): write the values out.")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST or count > MOST_EVENTS:
            raise InputError(TOO_LARGE.format(where))


def refuse_paths(data: Any, where: str) -> None:
    """Refuse strings that are absolute paths, URLs, or paths outside their folder.

    Raises
    ------
    InputError
    """
    for key, value in texts(data):
        if _LEADS_OUT.search(value) or "\0" in value:
            raise InputError(
                f"{where}: {key} is {value[:60]!r}, which points outside the service. Name an "
                "upload, FOLDER/FILE, or a volume in the store."
            )


def texts(data: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield all strings in plain values, with the dotted names of their keys."""
    if isinstance(data, str):
        yield key, data
    elif isinstance(data, dict):
        for name, value in data.items():
            yield from texts(value, f"{key}.{name}".lstrip("."))
    elif isinstance(data, list | tuple):
        for number, value in enumerate(data):
            yield from texts(value, f"{key}[{number}]")


def depth_of(data: Any) -> int:
    """Return the nesting depth of plain values, without recursion."""
    deepest, level = 0, [data]
    while level:
        deepest += 1
        if deepest > 2 * DEEPEST:
            break
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
        level = inner
    return deepest


UPLOAD_SUFFIXES = (
    ".nrrd", ".nii", ".nii.gz", ".tif", ".tiff", ".npy", ".dcm",
    ".yaml", ".yml", ".json", ".csv", ".txt", ".stl", ".vtk", ".msh",
)  # fmt: skip
MOST_TEXT_BYTES = 512 * 1024
UPLOAD_BLOCK_BYTES = 2**20


class TooLargeError(PalpateError):
    """An upload that exceeds the limits of the service."""


class ConflictError(PalpateError):
    """A different upload with the same name."""


@dataclass(frozen=True)
class Uploaded:
    """One uploaded file.

    Parameters
    ----------
    folder, file : str
    size_bytes : int
    sha256 : str
        Empty in a list.
    """

    folder: str
    file: str
    size_bytes: int
    sha256: str = ""


class Uploads:
    """The uploads of a service.

    Parameters
    ----------
    root : Path
        Must exist. Incomplete uploads of a killed service are removed.
    limits : Limits
    """

    def __init__(self, root: Path, limits: Limits) -> None:
        self.root, self.limits = root, limits
        self._lock = threading.Lock()
        for folder in (root, *(path for path in root.iterdir() if path.is_dir())):
            clean_leftovers(folder, older_than_s=0.0)
        self._count()

    def _count(self) -> None:
        """Count complete files and their bytes."""
        there = self.list()
        self._files, self._bytes = len(there), sum(one.size_bytes for one in there)

    def list(self) -> list[Uploaded]:
        """Return all uploads."""
        return [
            Uploaded(folder.name, file.name, file.stat().st_size)
            for folder in sorted(self.root.iterdir())
            if folder.is_dir() and not is_temporary(folder)
            for file in sorted(folder.iterdir())
            if file.is_file() and not is_temporary(file)
        ]

    async def save(self, folder: str, file: str, body: AsyncIterator[bytes]) -> Uploaded:
        """Write a file from a stream.

        Raises
        ------
        InputError
            If its kind is unknown, or it refers to other files.
        TooLargeError
            If it is too large, or there are too many.
        ConflictError
            If a different file has this name.
        StoreError
            If the disk is full.
        """
        path = self.root / checked_name(folder) / checked_name(file)
        if not file.lower().endswith(UPLOAD_SUFFIXES):
            raise InputError(
                f"{file} cannot be uploaded: expected one of "
                f"{', '.join(UPLOAD_SUFFIXES)}. Write an image as one file, such as NAME.nrrd."
            )
        writing = _Writing(self, file)
        temporary = temporary_sibling(path)
        try:
            with explained(path):
                path.parent.mkdir(exist_ok=True)
            size, sha256 = await writing.write(temporary, body)
            await to_thread.run_sync(_check_upload, temporary, file)
            if await to_thread.run_sync(self._publish, temporary, path, sha256):
                writing.keep()
        finally:
            discard(temporary)
            writing.forget()
        return Uploaded(folder, file, size, sha256)

    def take(self, files: int, size: int, file: str) -> None:
        """Add files and bytes to the total, including running uploads.

        Raises
        ------
        TooLargeError
            If the limits are exceeded.
        """
        with self._lock:
            if files > 0 and self._files >= self.limits.uploads_files:
                raise TooLargeError(f"There are {self._files} uploads already: remove some first.")
            if size > 0 and self._bytes + size > self.limits.uploads_bytes:
                raise self.too_large(file)
            self._files += files
            self._bytes += size

    def too_large(self, file: str) -> TooLargeError:
        """Return the error for a file that is too large."""
        return TooLargeError(
            f"{file} is too large: a file may have at most {self.limits.upload_bytes} bytes, "
            f"and all uploads together {self.limits.uploads_bytes}."
        )

    def remove(self, folder: str) -> bool:
        """Remove a folder of uploads; False if there is none."""
        path = self.root / checked_name(folder)
        there = path.is_dir()
        held = [one for one in self.list() if one.folder == folder]
        discard(path)
        self.take(-len(held), -sum(one.size_bytes for one in held), folder)
        return there

    def resolve(self, name: str) -> Path | None:
        """Return the path of ``FOLDER`` or ``FOLDER/FILE``; None if there is no such upload.

        Raises
        ------
        InputError
            If the name is not valid.
        """
        parts = name.split("/")
        if len(parts) > 2:
            raise InputError(f"{name!r} is not the name of an upload: expected FOLDER/FILE.")
        path = self.root.joinpath(*(checked_name(part) for part in parts))
        return path if path.exists() else None

    def _publish(self, temporary: Path, path: Path, sha256: str) -> bool:
        """Give a file its name; return False if the same file exists already."""
        with explained(path):
            sync(temporary)
            try:
                os.link(temporary, path)  # fails if the name is taken
            except FileExistsError:
                with path.open("rb") as there:
                    if hashlib.file_digest(there, "sha256").hexdigest() == sha256:
                        return False
                raise ConflictError(
                    f"A different {path.parent.name}/{path.name} exists: uploads are never "
                    "changed, as a study may use them. Choose another folder."
                ) from None
            sync(path.parent)
        return True


class _Writing:
    """Data written so far by one upload, which count towards the limits.

    Parameters
    ----------
    uploads : Uploads
    file : str
        Name of the file, for messages.

    Raises
    ------
    TooLargeError
        If there are too many files.
    """

    def __init__(self, uploads: Uploads, file: str) -> None:
        self.uploads, self.file, self.size = uploads, file, 0
        uploads.take(1, 0, file)
        self._taken = True

    async def write(self, temporary: Path, body: AsyncIterator[bytes]) -> tuple[int, str]:
        """Write the stream to a file; return its size and SHA-256."""
        state, waiting = hashlib.sha256(), bytearray()
        with explained(temporary.with_name(self.file)), temporary.open("wb") as out:

            def write() -> None:
                state.update(waiting)
                out.write(waiting)

            async for chunk in body:
                self._grow(len(chunk))
                waiting += chunk
                if len(waiting) >= UPLOAD_BLOCK_BYTES:
                    await to_thread.run_sync(write)
                    waiting.clear()
            await to_thread.run_sync(write)
        return self.size, state.hexdigest()

    def _grow(self, size: int) -> None:
        if self.size + size > self.uploads.limits.upload_bytes:
            raise self.uploads.too_large(self.file)
        self.uploads.take(0, size, self.file)
        self.size += size

    def keep(self) -> None:
        """Count the file until it is removed."""
        self._taken = False

    def forget(self) -> None:
        """Stop counting the file, unless it is kept."""
        if self._taken:
            self._taken = False
            self.uploads.take(-1, -self.size, self.file)


def _check_upload(path: Path, name: str) -> None:
    """Reject files that a reader would reject; see `workers.input_files`.

    Raises
    ------
    InputError
    """
    lower = name.lower()
    if lower.endswith(".nrrd"):
        check_attached(path, name)
    elif lower.endswith((".tif", ".tiff")):
        check_one_file(path, name)
    elif lower.endswith((".yaml", ".yml", ".json")):
        _check_uploaded_text(path, name)


def _check_uploaded_text(path: Path, name: str) -> None:
    if path.stat().st_size > MOST_TEXT_BYTES:
        raise TooLargeError(f"{name} may have at most {MOST_TEXT_BYTES} bytes.")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is not a text file: {error}.") from error
    data: Any = parsed_text(text, name)
    refuse_paths(data, name)


WHERE = "The study"
IMAGE_KEYS = {"volume", "file", "labels"}


def study_from(
    given: str | Mapping[str, Any], uploads: Uploads, store: Store, limits: Limits
) -> StudySpec:
    """Return the study requested by a client.

    Parameters
    ----------
    given : str or mapping
        The text of a study file, or its keys. Images are uploads, named FOLDER/FILE, or
        volumes in the store.

    Raises
    ------
    InputError
        If it is not valid, names files of the server, or is too large.
    """
    text = given if isinstance(given, str) else ""
    data = parsed_text(given, WHERE) if isinstance(given, str) else dict(given)
    if depth_of(data) > DEEPEST:
        raise InputError(f"{WHERE} is nested too deeply.")
    data = deepcopy(data)  # paths are made absolute
    refuse_paths(data, WHERE)
    spec = spec_from_keys(data, WHERE, uploads.root, text)
    _check_images(spec, uploads, store)
    _check_study_size(spec, limits)
    return spec


def _check_images(spec: StudySpec, uploads: Uploads, store: Store) -> None:
    for key, value in texts(spec.as_dict()):
        if key.rpartition(".")[2] not in IMAGE_KEYS:
            continue
        path = Path(value)
        uploaded = path.is_absolute() and path.resolve().is_relative_to(uploads.root.resolve())
        if not (uploaded and path.exists()) and not _in_store(value, store):
            raise InputError(
                f"{WHERE}: {key} is {value!r}, which is neither an upload (FOLDER/FILE) nor a "
                "volume in the store. Upload the image first."
            )


def _in_store(name: str, store: Store) -> bool:
    """Check whether the store has a volume with this digest or name."""
    with suppress(StoreError):  # not the name of a volume
        if has_volume(store, name):
            return True
    for volume in list_volumes(store):
        with suppress(StoreError):  # damaged
            if volume_meta(store, volume).get("name") == name:
                return True
    return False


def _check_study_size(spec: StudySpec, limits: Limits) -> None:
    search = spec.search
    if search.population > limits.population:
        raise InputError(
            f"{WHERE}: search.population is {search.population}; this service accepts up to "
            f"{limits.population}."
        )
    evaluations = search.population * search.generations
    if evaluations > limits.evaluations:
        raise InputError(
            f"{WHERE} requests up to {evaluations} evaluations; this service accepts up to "
            f"{limits.evaluations}."
        )
