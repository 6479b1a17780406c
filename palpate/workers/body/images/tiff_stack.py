"""TIFF images, read with tifffile: one file of many pages, or a folder of slices.

Columns are x, rows y and pages z. A folder is sorted by the numbers in the names;
see `workers.body.images.slice_names`. The resolution tags of plain TIFF describe
printing; they are ignored, and spacing must be given. ImageJ and OME files have
spacings with units, which are used; see `workers.body.images.tiff_spacing`.
"""

import logging
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.claimed_size import DEFLATE, SLACK_BYTES, claimed_bytes
from palpate.workers.body.images.scan import Scan, three_axes
from palpate.workers.body.images.slice_names import in_order
from palpate.workers.body.images.tiff_spacing import stated_spacing_mm
from palpate.workers.input_files import reading

# Formats of microscopes and scanners, some of which are read from several files.
_OTHER_KINDS = (
    "avs", "bif", "eer", "fluoview", "indica", "lsm", "mdgel", "mmstack", "ndpi", "ndtiff", "nih",
    "philips", "qpi", "scanimage", "scn", "sis", "stk", "svs",
)  # fmt: skip
_KINDS = {
    f"is_{kind}": False
    for kind in _OTHER_KINDS
    if kind in tifffile.TIFF.FILE_FLAGS
    and not isinstance(getattr(tifffile.TiffFile, f"is_{kind}", None), property)
}
_OME_FILE = re.compile(r"""<(?:\w+:)?UUID\b[^>]*?\bFileName=["']([^"']*)["'][^>]*>([^<]*)""")
_OME_NUMBER = re.compile(
    r"""\b(Size[XYZCT]|NumPlanes|PlaneCount|IFD|First[ZCT])=["']\s*([^"']*)["']"""
)
_DEFLATE = (8, 32946)
TIFF_SUFFIXES = (".tif", ".tiff")


def read_tiff(path: Path) -> Scan:
    """Read a multi-page file, or a folder whose files are the slices."""
    values, spacing_mm = _folder(path) if path.is_dir() else _pages(path)
    return Scan.without_frame(three_axes(values, str(path)).transpose(), spacing_mm)


def slices_of(folder: Path) -> list[Path]:
    """Return the slices of a folder, in the order of z.

    Raises
    ------
    InputError
        If their names do not determine their order.
    """
    return in_order([path for path in folder.iterdir() if _is_slice(path)], str(folder))


def slices_read(path: Path) -> list[str] | None:
    """Return the names of the first and last TIFF slice in a folder; None if it has none."""
    if not path.is_dir() or not any(_is_slice(file) for file in path.iterdir()):
        return None
    paths = slices_of(path)
    return [paths[0].name, paths[-1].name]


def _pages(path: Path) -> tuple[NDArray[Any], FloatArray]:
    """Return the pages of a file, and its spacing along x, y and z."""
    with _damage_raises(path), tifffile.TiffFile(path, _multifile=False, **_KINDS) as tiff:
        _check_ome(path, tiff)
        if len(tiff.series) != 1:
            raise InputError(
                f"{path} has {len(tiff.series)} images of different kinds, expected one stack "
                "of equal pages. Save the label map alone."
            )
        series = tiff.series[0]
        claimed_bytes(series.shape, series.dtype.itemsize, str(path))
        _check_segments(path, series)
        return np.asarray(series.asarray()), stated_spacing_mm(tiff)


def check_one_file(path: Path, what: str) -> None:
    """Raise InputError if a file is not TIFF, or its metadata name other files.

    Parameters
    ----------
    path : Path
    what : str
        Name of the file in messages.
    """
    with (
        reading(what, "TIFF"),
        tifffile.TiffFile(path, _multifile=False, **_KINDS) as tiff,
    ):
        if not len(tiff.pages):
            raise ValueError("it has no pages")
        _check_ome(Path(what), tiff)


def _check_ome(path: Path, tiff: tifffile.TiffFile) -> None:
    """Raise InputError if OME metadata name other files, or describe more than a file can hold."""
    if getattr(tiff, "is_mmstack", False) or getattr(tiff, "is_ndtiff", False):
        raise InputError(f"{path} is part of an image in several files. Save it as one TIFF file.")
    text = tiff.ome_metadata if tiff.is_ome else None
    if not text:
        return
    own = re.search(r"<(?:\w+:)?OME\b[^>]*?\bUUID=[\"']([^\"']*)", text)
    for name, uuid in _OME_FILE.findall(text):
        if name.lower() != path.name.lower() and (own is None or uuid.strip() != own[1].strip()):
            raise InputError(
                f"{path} is an OME-TIFF that names other files ({name[:80]!r}). Save the label map "
                "as one TIFF file."
            )
    for name, number in _OME_NUMBER.findall(text):
        if len(number) > 7:
            raise InputError(f"{path} has {name} = {number[:20]} in its OME metadata: too many.")


def _check_segments(path: Path, series: tifffile.TiffPageSeries) -> None:
    """Raise InputError if a compressed strip or tile contains more than a page needs."""
    for page in series.pages:
        if page is None or page.compression not in _DEFLATE:
            continue
        most = max(page.nbytes, SLACK_BYTES)
        for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False):
            if DEFLATE * count <= most:
                continue
            page.parent.filehandle.seek(offset)
            stream = zlib.decompressobj()
            stream.decompress(page.parent.filehandle.read(count), most)
            if stream.unconsumed_tail:
                raise InputError(
                    f"{path} is damaged: a compressed part of it has more pixels than its page. "
                    "Export it again."
                )


def _folder(folder: Path) -> tuple[NDArray[Any], FloatArray]:
    paths = slices_of(folder)
    first, spacing_mm = _pages(paths[0])
    claimed_bytes((len(paths), *first.shape), first.dtype.itemsize, str(folder))
    if first.ndim != 2:
        raise InputError(
            f"{paths[0]} has shape {first.shape}, expected one slice (rows, columns). "
            "Give a multi-page file by its own name instead of its folder."
        )
    stack = np.empty((len(paths), *first.shape), first.dtype)
    for index, path in enumerate(paths):
        page, _ = _pages(path)
        if page.shape != first.shape or page.dtype != first.dtype:
            raise InputError(
                f"{path} is a slice of shape {page.shape} and type {page.dtype}, but "
                f"{paths[0].name} has {first.shape} and {first.dtype}; all slices of a stack "
                "must be alike. Keep only the slices of one stack in the folder."
            )
        stack[index] = page
    return stack, spacing_mm


def _is_slice(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in TIFF_SUFFIXES and path.name[0] != "."


@contextmanager
def _damage_raises(path: Path) -> Iterator[None]:
    """Raise one error for any damage; tifffile only logs missing last pages."""
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
