"""Read TIFF, with tifffile: one file of many pages, or a folder of slices.

Columns are x, rows y and pages z. A folder is sorted by name with numbers as
numbers (slice2 before slice10). The resolution tags of TIFF mostly tell how to
print the image; they are not read, and spacing must be given.
"""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from storage.errors import InputError
from workers.body.images.scan import Scan, three_axes

TIFF_SUFFIXES = (".tif", ".tiff")


def read_tiff(path: Path) -> Scan:
    """Read a multi-page file, or a folder whose files are the slices."""
    values = _folder(path) if path.is_dir() else _pages(path)
    return Scan.without_frame(three_axes(values, str(path)).transpose())


def _pages(path: Path) -> NDArray[Any]:
    with _damage_raises(path), tifffile.TiffFile(path) as tiff:
        if len(tiff.series) != 1:
            raise InputError(
                f"{path} holds {len(tiff.series)} images of different kinds, expected one stack "
                "of equal pages. Save the label map alone."
            )
        return np.asarray(tiff.series[0].asarray())


def _folder(folder: Path) -> NDArray[Any]:
    paths = sorted(
        (p for p in folder.iterdir() if _is_slice(p)),
        key=_natural,
    )
    first = _pages(paths[0])
    if first.ndim != 2:
        raise InputError(
            f"{paths[0]} has shape {first.shape}, expected one slice (rows, columns). "
            "Give a multi-page file by its own name instead of its folder."
        )
    stack = np.empty((len(paths), *first.shape), first.dtype)
    for index, path in enumerate(paths):
        page = _pages(path)
        if page.shape != first.shape or page.dtype != first.dtype:
            raise InputError(
                f"{path} is a slice of shape {page.shape} and type {page.dtype}, but "
                f"{paths[0].name} has {first.shape} and {first.dtype}; all slices of a stack "
                "must be alike. Keep only the slices of one stack in the folder."
            )
        stack[index] = page
    return stack


def _is_slice(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in TIFF_SUFFIXES and path.name[0] != "."


def _natural(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(p), p) if p.isdigit() else (-1, p) for p in parts]


@contextmanager
def _damage_raises(path: Path) -> Iterator[None]:
    """Raise one error for all damage; tifffile only logs that a file lost its last pages."""
    said: list[str] = []
    cause: Exception | None = None

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    listener = Listener(level=logging.ERROR)
    logger = logging.getLogger("tifffile")
    logger.addHandler(listener)
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # decoders raise nearly anything
        cause = error
        said.append(str(error) or type(error).__name__)
    finally:
        logger.removeHandler(listener)
    if said:
        raise InputError(
            f"{path} is damaged or cut short: {said[0]}. Copy or export it again."
        ) from cause
