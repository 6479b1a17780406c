"""TIFF images, read with tifffile: one file of many pages, or a folder of slices.

Columns are x, rows y and pages z. A folder is sorted by the numbers in the names of its files.

Only ImageJ and OME files have spacings with units, which are used. The resolution tags of plain
TIFF describe printing; they are ignored, and so is ImageJ's inch, which comes from the print
resolution of an image. Spacing must then be given.
"""

import logging
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from tifffile import TiffFile

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.claimed_size import DEFLATE, SLACK_BYTES, claimed_bytes
from palpate.workers.body.images.scan_orientation import Scan, three_axes
from palpate.workers.input_files import reading

_UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "micron": 1e-3, "nm": 1e-6}
_NAMES = {
    "millimeter": "mm",
    "millimetre": "mm",
    "centimeter": "cm",
    "microns": "um",
    "micrometer": "um",
    "micrometre": "um",
}
_OME_SIZE = re.compile(r'PhysicalSize([XYZ])(Unit)?="([^"]*)"')


def stated_spacing_mm(tiff: TiffFile) -> FloatArray:
    """Return the spacing along x, y and z; NaN where the file gives none with a unit."""
    if tiff.is_ome and tiff.ome_metadata:
        return _of_ome(tiff.ome_metadata)
    if tiff.is_imagej and tiff.imagej_metadata:
        return _of_imagej(tiff, tiff.imagej_metadata)
    return np.full(3, np.nan)


def _of_ome(text: str) -> FloatArray:
    sizes: dict[str, str] = {}
    units: dict[str, str] = {}
    for axis, unit, value in _OME_SIZE.findall(text):
        (units if unit else sizes).setdefault(axis, value)
    return np.array([_number(sizes.get(a)) * _mm(units.get(a, "um")) for a in "XYZ"])


def _of_imagej(tiff: TiffFile, facts: dict[str, Any]) -> FloatArray:
    unit = _mm(str(facts.get("unit", "")))
    tags = tiff.pages[0].tags
    spacing = [_pixel(tags.get("XResolution")), _pixel(tags.get("YResolution"))]
    return unit * np.array([*spacing, _number(facts.get("spacing"))])


def _pixel(tag: Any) -> float:
    """Return the size of a pixel from a tag that gives pixels per unit as a fraction."""
    if tag is None or not tag.value[0]:
        return np.nan
    return float(tag.value[1]) / float(tag.value[0])


def _number(given: Any) -> float:
    try:
        return float(given)
    except (TypeError, ValueError):
        return np.nan


def _mm(unit: str) -> float:
    """Return the length of a unit in mm; NaN if it is not a plausible unit of length."""
    plain = unit.strip().lower()
    for micro in ("\\u00b5", "\u00b5", "\u03bc"):  # ImageJ writes the escape itself
        plain = plain.replace(micro, "u")
    return _UNIT_MM.get(_NAMES.get(plain, plain), np.nan)


# A minus sign after a letter is a hyphen unless that makes no sense: slice-1 is slice 1.
_SIGNED = re.compile(r"((?<![^\W_])[+-]?\d+(?:[.,]\d+)*)")
_AFTER_LETTERS = re.compile(r"((?<!\d)[+-]?\d+(?:[.,]\d+)*)")
_EVEN = 0.05
"""Allowed deviation of a number from its position in the row, in steps."""


@dataclass(frozen=True)
class _NumberRow:
    """The values of one number in the file names, over all files.

    Parameters
    ----------
    values : ndarray, shape (n,)
    decimals : int
        Digits after the decimal point.
    """

    values: FloatArray
    decimals: int

    @property
    def order(self) -> list[int]:
        return [int(k) for k in np.argsort(self.values, kind="stable")]

    @property
    def step(self) -> float:
        return float(np.median(np.diff(np.sort(self.values))))

    @property
    def is_even(self) -> bool:
        gaps = np.diff(np.sort(self.values))
        slack = max(_EVEN * self.step, 10.0**-self.decimals if self.decimals else 0.0)
        return bool(gaps.min() > 0 and np.all(np.abs(gaps - self.step) <= slack))


def in_order(paths: Sequence[Path], what: str) -> list[Path]:
    """Sort the files of slices by the number in their names.

    Numbers may be signed and have decimals. They must form one evenly spaced row.

    Parameters
    ----------
    paths : sequence of Path
        Files of one folder, one for each slice.
    what : str
        Name of the folder in messages.

    Raises
    ------
    InputError
        If names differ in more than numbers, a number is missing or used for two
        slices, or two numbers in the names give different orders.
    """
    if len(paths) < 2:
        return list(paths)
    paths = sorted(paths, key=lambda path: path.name)
    rows = [row for row in _number_rows(paths, what) if np.ptp(row.values) > 0]
    even = [row for row in rows if row.is_even]
    if not even:
        _refuse_names(rows, paths, what)
    order = even[0].order
    for row in even[1:]:
        if row.order != order:
            raise InputError(
                f"{what}: two numbers in the names of the slices give different orders: "
                f"{paths[order[0]].name} or {paths[row.order[0]].name} first. Rename the slices "
                "with one number each."
            )
    return [paths[k] for k in order]


def _number_rows(paths: Sequence[Path], what: str) -> list[_NumberRow]:
    """Return the numbers in the names, which must otherwise be equal."""
    for pattern in (_SIGNED, _AFTER_LETTERS):
        split = [pattern.split(path.stem.lower()) for path in paths]
        numbers = [_apart(parts[1::2]) for parts in split]
        odd = [k for k, parts in enumerate(split) if parts[::2] != split[0][::2]]
        odd = odd or [k for k, numbering in enumerate(numbers) if len(numbering) != len(numbers[0])]
        if not odd:
            return [
                _number_row([numbering[k] for numbering in numbers]) for k in range(len(numbers[0]))
            ]
    raise InputError(
        f"{what}: the names of the slices differ in more than a number ({paths[0].name}, "
        f"{paths[odd[0]].name}), so their order is unknown. Keep the slices of one image, and "
        "number them, such as slice001.tif."
    )


def _apart(numbers: Sequence[str]) -> list[str]:
    """Split numbers that have several points, such as dates and UIDs, into parts."""
    found: list[str] = []
    for number in numbers:
        parts = re.split("[.,]", number)
        found += parts if len(parts) > 2 else [".".join(parts)]
    return found


def _number_row(numbers: Sequence[str]) -> _NumberRow:
    decimals = max(len(number.partition(".")[2]) for number in numbers)
    return _NumberRow(np.array([float(number) for number in numbers]), decimals)


def _refuse_names(rows: Sequence[_NumberRow], paths: Sequence[Path], what: str) -> None:
    """Raise InputError with the reason why the numbers are not an evenly spaced row."""
    if not rows:
        raise InputError(
            f"{what}: several slices have the same number in their names: "
            f"{', '.join(path.name for path in paths[:4])}. Keep the slices of one image."
        )
    row = max(rows, key=lambda row: len(set(row.values.tolist())))
    values, order = row.values[row.order], row.order
    gaps = np.diff(values)
    if gaps.min() <= 0:
        twice = int(np.argmin(gaps))
        names = f"{paths[order[twice]].name} and {paths[order[twice + 1]].name}"
        raise InputError(
            f"{what} has two slices numbered {values[twice]:g}: {names}. Keep the slices of one "
            "image, and number them from 1."
        )
    raise InputError(
        f"{what} {_gap_in_words(values, [paths[k].name for k in order])}. Complete the slices, or "
        "resample them at even distances."
    )


def _gap_in_words(values: FloatArray, names: Sequence[str]) -> str:
    gaps = np.diff(values)
    step, wide = float(np.median(gaps)), int(np.argmax(gaps))
    between = f"between {names[wide]} and {names[wide + 1]}"
    times = gaps / step
    if np.all(np.abs(times - np.rint(times)) < 2 * _EVEN):
        lost = [
            f"{value + step * k:g}"
            for value, count in zip(values[:-1], np.rint(times).astype(int), strict=True)
            for k in range(1, count)
        ]
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        return f"lacks slices: number {', '.join(lost[:8])}{more} ({between})"
    return (
        f"has unevenly numbered slices: numbers differ by {gaps[wide]:g} {between}, "
        f"by {step:g} elsewhere"
    )


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
_DEFLATE, _PACKBITS = (8, 32946), 32773
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
    with reading(what, "TIFF"), tifffile.TiffFile(path, _multifile=False, **_KINDS) as tiff:
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
    """Raise InputError if a compressed strip or tile does not contain what its page needs.

    Deflate and LZMA have checksums, which the decoder compares. PackBits has none, and a changed
    length shifts all that follows: its strips must expand to the size that the page states.
    """
    for page in series.pages:
        if page is None:
            continue
        if page.compression not in tifffile.TIFF.DECOMPRESSORS:
            kind = getattr(page.compression, "name", f"method {page.compression}")
            raise InputError(
                f"{path} is compressed by {kind}, which cannot be read here. Save it without "
                "compression, or with deflate (zip)."
            )
        if page.compression == _PACKBITS:
            _check_packbits(path, page)
        if page.compression not in _DEFLATE:
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


def _check_packbits(path: Path, page: Any) -> None:
    first = page.keyframe
    for index, (offset, count) in enumerate(
        zip(page.dataoffsets, page.databytecounts, strict=False)
    ):
        _, _, (depth, rows, columns, samples) = first.decode(None, index)
        row_bytes = -(-columns * samples * first.bitspersample // 8)
        padded = rows if first.is_tiled else max(rows, first.rowsperstrip)
        page.parent.filehandle.seek(offset)
        stored = page.parent.filehandle.read(count)
        size = len(tifffile.TIFF.DECOMPRESSORS[_PACKBITS](stored))
        if size not in (depth * rows * row_bytes, depth * padded * row_bytes):
            raise InputError(
                f"{path} is damaged: part {index + 1} of a page expands to {size} bytes, expected "
                f"{depth * rows * row_bytes} (PackBits). Copy or export it again."
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
