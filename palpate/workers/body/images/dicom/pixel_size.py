"""Pixel sizes in the header of a DICOM file, checked before pixels are decoded."""

from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError
from palpate.workers.body.images.claimed_size import check_stored, claimed_bytes

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
    return size, each


def _whole(path: Path, dataset: Any, name: str, default: int = 1) -> int:
    value = dataset.get(name)
    try:
        return default if value is None else int(value)
    except (TypeError, ValueError):
        raise InputError(f"{path} has {name} {str(value)[:40]!r}, expected one number.") from None
