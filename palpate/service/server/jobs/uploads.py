"""Uploaded images and cases, written completely or not at all and never changed.

A name is a folder and a file in it. Readers only open files in the folder of an upload
(`workers.input_files`); a case with paths to other folders is refused here as well, so that
the error appears at once.

Files are hashed, checked and synced in threads. Data written by running uploads count towards
the limits.
"""

import hashlib
import os
import threading
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anyio import to_thread

from palpate.service.server.jobs.home import checked_name
from palpate.service.server.jobs.limits import Limits
from palpate.service.server.jobs.yaml import parsed_text, refuse_paths
from palpate.storage.backends.atomic import (
    clean_leftovers,
    discard,
    explained,
    is_temporary,
    sync,
    temporary_sibling,
)
from palpate.storage.errors import InputError, PalpateError
from palpate.workers.body.images.nrrd_header import check_attached
from palpate.workers.body.images.tiff_stack import check_one_file

SUFFIXES = (
    ".nrrd", ".nii", ".nii.gz", ".tif", ".tiff", ".npy", ".dcm",
    ".yaml", ".yml", ".json", ".csv", ".txt", ".stl", ".vtk", ".msh",
)  # fmt: skip
TEXT_BYTES = 512 * 1024
BLOCK_BYTES = 2**20


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
        if not file.lower().endswith(SUFFIXES):
            raise InputError(
                f"{file} cannot be uploaded: expected one of "
                f"{', '.join(SUFFIXES)}. Write an image as one file, such as NAME.nrrd."
            )
        writing = _Writing(self, file)
        temporary = temporary_sibling(path)
        try:
            with explained(path):
                path.parent.mkdir(exist_ok=True)
            size, sha256 = await writing.write(temporary, body)
            await to_thread.run_sync(_check, temporary, file)
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
                if len(waiting) >= BLOCK_BYTES:
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


def _check(path: Path, name: str) -> None:
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
        _check_text(path, name)


def _check_text(path: Path, name: str) -> None:
    if path.stat().st_size > TEXT_BYTES:
        raise TooLargeError(f"{name} may have at most {TEXT_BYTES} bytes.")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is not a text file: {error}.") from error
    data: Any = parsed_text(text, name)
    refuse_paths(data, name)
