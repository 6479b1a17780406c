"""Images and cases that clients bring: written whole or not at all, and never changed.

A name is a folder and a file in it. What another file could make a reader open elsewhere
is refused: detached headers, TIFF files that name others, paths in a case.
"""

import hashlib
import os
import re
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.service.server.jobs.home import checked_name
from palpate.service.server.jobs.limits import Limits
from palpate.service.server.jobs.yaml import parsed_text, refuse_paths
from palpate.storage.backends.atomic import (
    discard,
    explained,
    is_temporary,
    sync,
    temporary_sibling,
)
from palpate.storage.errors import InputError, PalpateError

SUFFIXES = (
    ".nrrd", ".nii", ".nii.gz", ".tif", ".tiff", ".npy", ".dcm",
    ".yaml", ".yml", ".json", ".csv", ".txt", ".stl", ".vtk", ".msh",
)  # fmt: skip
TEXT_BYTES = 512 * 1024
_DETACHED = re.compile(rb"^data ?file\s*:", re.IGNORECASE | re.MULTILINE)


class TooLargeError(PalpateError):
    """An upload is larger than the service accepts."""


class ConflictError(PalpateError):
    """There is another upload of that name."""


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
        Exists.
    limits : Limits
    """

    def __init__(self, root: Path, limits: Limits) -> None:
        self.root, self.limits = root, limits

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
            If it is of an unknown kind, or leads to other files.
        TooLargeError
            If it is too large, or there are too many.
        ConflictError
            If another file has that name.
        StoreError
            If the disk is full.
        """
        path = self.root / checked_name(folder) / checked_name(file)
        if not file.lower().endswith(SUFFIXES):
            raise InputError(
                f"{file} is of a kind that cannot be uploaded: expected one of "
                f"{', '.join(SUFFIXES)}. Write an image as one file, such as NAME.nrrd."
            )
        others = self.list()
        held, count = sum(one.size_bytes for one in others), len(others)
        if count >= self.limits.uploads_files:
            raise TooLargeError(f"There are {count} uploads already: remove some first.")
        with explained(path):
            path.parent.mkdir(exist_ok=True)
        temporary = temporary_sibling(path)
        try:
            size, sha256 = await self._write(temporary, file, body, held)
            _check(temporary, file)
            self._publish(temporary, path, sha256)
        finally:
            discard(temporary)
        return Uploaded(folder, file, size, sha256)

    def remove(self, folder: str) -> bool:
        """Remove a folder of uploads; False if there is none."""
        path = self.root / checked_name(folder)
        there = path.is_dir()
        discard(path)
        return there

    def resolve(self, name: str) -> Path | None:
        """Return the path of ``FOLDER`` or ``FOLDER/FILE``; None if there is no such upload.

        Raises
        ------
        InputError
            If it is no such name.
        """
        parts = name.split("/")
        if len(parts) > 2:
            raise InputError(f"{name!r} is no upload: expected FOLDER/FILE.")
        path = self.root.joinpath(*(checked_name(part) for part in parts))
        return path if path.exists() else None

    async def _write(
        self, temporary: Path, file: str, body: AsyncIterator[bytes], held: int
    ) -> tuple[int, str]:
        state, size = hashlib.sha256(), 0
        with explained(temporary.with_name(file)), temporary.open("wb") as out:
            async for chunk in body:
                size += len(chunk)
                if size > self.limits.upload_bytes or held + size > self.limits.uploads_bytes:
                    raise TooLargeError(
                        f"{file} is too large: one file may have {self.limits.upload_bytes} "
                        f"bytes, all uploads together {self.limits.uploads_bytes}."
                    )
                state.update(chunk)
                out.write(chunk)
        return size, state.hexdigest()

    def _publish(self, temporary: Path, path: Path, sha256: str) -> None:
        with explained(path):
            sync(temporary)
            try:
                os.link(temporary, path)  # fails where the name is taken
            except FileExistsError:
                with path.open("rb") as there:
                    if hashlib.file_digest(there, "sha256").hexdigest() == sha256:
                        return
                raise ConflictError(
                    f"There is another {path.parent.name}/{path.name}: an upload is never "
                    "changed, for a study may use it. Choose another folder."
                ) from None
            sync(path.parent)


def _check(path: Path, name: str) -> None:
    """Refuse a file that makes its reader open others.

    Raises
    ------
    InputError
    """
    lower = name.lower()
    if lower.endswith(".nrrd"):
        with path.open("rb") as file:
            header = file.read(TEXT_BYTES).partition(b"\n\n")[0].replace(b"\r", b"")
        if _DETACHED.search(header):
            raise InputError(f"{name} names other files for its data: write it as one file.")
    elif lower.endswith((".tif", ".tiff")):
        _check_tiff(path, name)
    elif lower.endswith((".yaml", ".yml", ".json")):
        _check_text(path, name)


def _check_tiff(path: Path, name: str) -> None:
    with path.open("rb") as file:
        overlap, block = b"", file.read(2**20)
        while block:
            if b"FileName=" in overlap + block:
                raise InputError(f"{name} is an OME-TIFF that names files: write it as plain TIFF.")
            overlap, block = block[-16:], file.read(2**20)


def _check_text(path: Path, name: str) -> None:
    if path.stat().st_size > TEXT_BYTES:
        raise TooLargeError(f"{name} may have {TEXT_BYTES} bytes.")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is no text: {error}.") from error
    data: Any = parsed_text(text, name)
    refuse_paths(data, name)
