"""Limits on the image size that a header claims, checked before memory is allocated.

Every reader of a format asks here before it allocates an array. DICOM spreads the size of its
pixels over several fields; `pixel_bytes` reads them before any pixel is decoded.

Nothing in a file is skipped in silence: of what follows the voxels, or a stream of bzip2, only
zeros are ignored (`bz2.BZ2File` ignores more, such as a second stream whose first byte has
changed).
"""

import bz2
import io
import os
import resource
from collections.abc import Iterable
from functools import cache
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

from palpate.storage.errors import InputError

LARGEST_BYTES = 2**30
"""Largest voxel array of an image, in bytes."""
COPIES = 4
"""Number of voxel arrays that reading and checking an image may hold at once."""
DEFLATE, BZIP2 = 1040, 50_000
"""Largest ratio between expanded and compressed size, rounded up."""
SLACK_BYTES = 2**16
_CGROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def claimed_bytes(shape: Iterable[int], bytes_each: float, what: str) -> int:
    """Return the size of the array described by a header.

    Parameters
    ----------
    shape : iterable of int
    bytes_each : float
        Size of one element.
    what : str
        Name of the image in messages.

    Returns
    -------
    int
        Bytes.

    Raises
    ------
    InputError
        If a size is not positive, or the array is too large for this machine.
    """
    sizes = [int(size) for size in shape]
    if not sizes or min(sizes) < 1:
        raise InputError(f"{what} gives the sizes {sizes[:8]}, expected numbers of voxels >= 1.")
    size = prod(sizes) * round(8 * bytes_each) // 8
    most = min(LARGEST_BYTES, memory_bytes() // COPIES)
    if size > most:
        listed = " x ".join(str(n)[:24] for n in sizes[:8])
        raise InputError(
            f"{what} has, according to its header, {listed} voxels, which need {_mib(size)} MiB; "
            f"images of up to {_mib(most)} MiB are supported. Check its header; crop the image or "
            "resample it, and save labels as 8-bit numbers."
        )
    return size


def check_stored(size: int, held: int, ratio: float, what: str) -> None:
    """Raise InputError if a file is too small for the array that its header describes.

    Parameters
    ----------
    size : int
        Bytes of the array.
    held : int
        Bytes of its data in the file.
    ratio : float
        Largest ratio of the data to the file: 1 without compression.
    what : str
        Name of the image in messages.
    """
    if size > ratio * held + (SLACK_BYTES if ratio > 1 else 0):
        raise InputError(
            f"{what} is cut short, or its header is wrong: the header describes {_amount(size)} "
            f"of voxels, but the file holds {_amount(held)}. Copy or export it again."
        )


def check_end(stream: Any, what: str) -> None:
    """Read a stream to its end, and raise InputError if more than padding follows the voxels.

    Parameters
    ----------
    stream : binary file
        Positioned after the last voxel.
    what : str
        Name of the image in messages.
    """
    check_padding(stream.read(SLACK_BYTES + 1), what)


def check_padding(rest: bytes, what: str) -> None:
    """Raise InputError if the bytes after the voxels are not a few zeros."""
    if len(rest) > SLACK_BYTES or rest.strip(b"\0"):
        raise InputError(
            f"{what} holds more voxels than its header states. Its header is wrong, or the file "
            "is damaged; copy or export it again."
        )


@cache
def memory_bytes() -> int:
    """Return the memory available to this process, given its machine, container and limits."""
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for path in map(Path, _CGROUPS):
        try:
            limits.append(int(path.read_text()))
        except (OSError, ValueError):  # no container, or no limit
            continue
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
        soft, _ = resource.getrlimit(kind)
        if soft != resource.RLIM_INFINITY:
            limits.append(soft)
    return min(limits)


def _amount(size: int) -> str:
    return f"{_mib(size)} MiB" if size >= 2**20 else f"{size} bytes"


def _mib(size: int) -> str:
    return f"{min(size, 2**200) / 2**20:.4g}"


BITS = (1, 8, 16, 32, 64)


def pixel_bytes(path: Path, dataset: Any) -> tuple[int, int]:
    """Return the number of bytes of all decoded pixels, and of one pixel.

    Parameters
    ----------
    path : Path
        Path of the file, for messages.
    dataset : pydicom.Dataset
        Must have ``Rows``.

    Raises
    ------
    InputError
        If a size is missing or invalid, or the file has fewer pixels than its header gives.
    """
    names = ("Rows", "Columns", "NumberOfFrames", "SamplesPerPixel")
    sizes = [_whole(path, dataset, name) for name in names]
    bits = _whole(path, dataset, "BitsAllocated", 8)
    if bits not in BITS:
        raise InputError(f"{path} has BitsAllocated {bits}, expected one of {BITS}.")
    each = max(bits // 8, 1)
    size = claimed_bytes(sizes, each, str(path))
    syntax = getattr(dataset, "file_meta", {}).get("TransferSyntaxUID")
    if syntax is not None and not syntax.is_compressed and "PixelData" in dataset:
        stored = size if bits > 1 else size // 8
        check_stored(stored, len(dataset.PixelData), 1, str(path))
        check_padding(dataset.PixelData[size if bits > 1 else -(-size // 8) :], str(path))
    return size, each


def _whole(path: Path, dataset: Any, name: str, default: int = 1) -> int:
    value = dataset.get(name)
    try:
        return default if value is None else int(value)
    except (TypeError, ValueError):
        raise InputError(f"{path} has {name} {str(value)[:40]!r}, expected one number.") from None


_BLOCK_BYTES = 2**16


class Bzip2Stream(io.RawIOBase):
    """Content of bzip2 data, which, unlike in `bz2.BZ2File`, only zeros may follow.

    Parameters
    ----------
    file : binary file
        Positioned at the beginning of the data.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._stream = bz2.BZ2Decompressor()
        self._held = b""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer, and return the number of bytes; see `io.RawIOBase`."""
        part = b""
        while not part and not (self._stream.eof and self._nothing_follows()):
            if self._stream.needs_input and not self._held:
                self._held = self._file.read(_BLOCK_BYTES)
                if not self._held:
                    raise EOFError("its compressed data have no end")
            part = self._stream.decompress(self._held, len(buffer))
            self._held = b""
        buffer[: len(part)] = part
        return len(part)

    def _nothing_follows(self) -> bool:
        """Skip zeros after a stream; begin the next one, unless the file ends."""
        self._held = self._stream.unused_data.lstrip(b"\0")
        while not self._held and (block := self._file.read(_BLOCK_BYTES)):
            self._held = block.lstrip(b"\0")
        if self._held:
            self._stream = bz2.BZ2Decompressor()
        return not self._held
