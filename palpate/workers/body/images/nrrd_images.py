"""NRRD images: the header line by line, then the voxels, and nothing else.

The known fields are listed here (http://teem.sourceforge.net/nrrd/format.html); pynrrd only
parses their values. The voxels are in the file itself. A separate header, with the suffix
``.nhdr``, names the file with the voxels; in any other file the field ``data file`` is refused.

The header's ``space`` names the frame; LPS, RAS and LAS are converted to LPS. Spaces without
anatomy (``scanner-xyz``, ``3D-right-handed``, ``space dimension: 3`` or none) are used
unchanged. Without ``space directions`` the index axes are x, y, z at the header's ``spacings``,
and the position is unknown; a header that nevertheless has an origin is refused. Names of labels
follow 3D Slicer's segmentations (``.seg.nrrd``).
"""

import gzip
import io
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import nrrd
import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.body.images.claimed_size import (
    BZIP2,
    DEFLATE,
    Bzip2Stream,
    check_stored,
    claimed_bytes,
)
from palpate.workers.body.images.scan_orientation import (
    RAS_TO_LPS,
    SPACING_TOLERANCE,
    Scan,
    three_axes,
)
from palpate.workers.input_files import check_regular, named_by, reading

HEADER_SUFFIX = ".nhdr"
HEADER_BYTES = 4 * 2**20
MAGIC = re.compile(rb"NRRD000[1-5]\s*")
DATA_FILE = "data file"
FIELDS = frozenset(
    {
        "dimension", "type", "block size", "encoding", "endian", "content", "old min", "old max",
        "min", "max", "data file", "line skip", "byte skip", "number", "sample units", "sizes",
        "spacings", "thicknesses", "axis mins", "axis maxs", "centers", "centerings", "labels",
        "units", "kinds", "space", "space dimension", "space units", "space origin",
        "space directions", "measurement frame",
    }
)  # fmt: skip
_WITHOUT_BLANKS = {field.replace(" ", ""): field for field in FIELDS}
_TYPES = {
    "i1": ("signed char", "int8", "int8_t"),
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i8": (
        "longlong", "long long", "long long int", "signed long long", "signed long long int",
        "int64", "int64_t",
    ),
    "u8": (
        "ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t",
    ),
    "f4": ("float",),
    "f8": ("double",),
}  # fmt: skip
_CODES = {name: code for code, names in _TYPES.items() for name in names}
_GZIP, _BZIP2, _TEXT = ("gzip", "gz"), ("bzip2", "bz2"), ("ascii", "text", "txt")


def read_nrrd_file(path: Path) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the voxels of an NRRD file, by index axis, and its header.

    Raises
    ------
    InputError
        If a field is unknown, the file names another one without being a ``.nhdr``, or its
        voxels do not match its header.
    """
    with path.open("rb") as file:
        header = _header(path, file)
        name = header.pop(DATA_FILE, None)
        if name is None:
            return _voxels(path, file, header), header
    if path.suffix.lower() != HEADER_SUFFIX:
        _refuse_other_file(str(path), name)
    data = named_by(path, name)
    check_regular(data)
    with data.open("rb") as file:
        return _voxels(data, file, header), header


def check_attached(path: Path, what: str) -> None:
    """Raise InputError if a file is not NRRD, or names another file for its voxels.

    Parameters
    ----------
    path : Path
    what : str
        Name of the file in messages.
    """
    with reading(what, "NRRD"), path.open("rb") as file:
        name = _header(Path(what), file).get(DATA_FILE)
        if name is not None:
            _refuse_other_file(what, name)


def _refuse_other_file(what: str, name: str) -> NoReturn:
    raise InputError(
        f"{what} stores its data in another file, {name[:80]!r}. Save both as one file. (On your "
        f"own machine, a header with the suffix {HEADER_SUFFIX} may have a separate data file.)"
    )


def _header(path: Path, file: BinaryIO) -> dict[str, Any]:
    """Return fields with parsed values and keys with text; leave `file` after the header."""
    magic = file.readline(64)
    if not MAGIC.fullmatch(magic):
        raise ValueError("it does not begin with NRRD and a version from 1 to 5")
    fields: dict[str, str] = {}
    keys: dict[str, Any] = {}
    for number, line in enumerate(iter(lambda: file.readline(HEADER_BYTES), b""), start=2):
        if file.tell() > HEADER_BYTES:
            raise InputError(f"{path} has a header of more than {HEADER_BYTES // 2**20} MiB.")
        text = line.decode("utf-8", "replace").rstrip()
        if not text:
            break
        if text.startswith("#"):
            continue
        key, mark, value = text.partition(":")
        entries = keys if value.startswith("=") else fields
        name = key if entries is keys else _field(key)
        if not mark or name is None or (entries is keys and _field(key) is not None):
            _refuse_line(path, number, text)
        if name in entries:
            raise InputError(f"{path}, line {number}: {name!r} is given twice. Keep one line.")
        entries[name] = value.removeprefix("=").strip()
    lines = [magic.decode(), *(f"{name}: {value}" for name, value in fields.items())]
    return keys | nrrd.read_header(lines)


def _field(key: str) -> str | None:
    """Return the field for any spelling of a key; None if there is no such field."""
    return _WITHOUT_BLANKS.get("".join(key.split()).lower())


def _refuse_line(path: Path, number: int, text: str) -> NoReturn:
    raise InputError(
        f"{path}, line {number}: {text[:60]!r} is not an NRRD field. The file is damaged "
        "or misnamed; copy or export it again."
    )


def _voxels(path: Path, file: BinaryIO, header: dict[str, Any]) -> NDArray[Any]:
    missing = [name for name in ("dimension", "type", "encoding", "sizes") if name not in header]
    if missing:
        raise InputError(f"{path} lacks {missing[0]} in its header. Copy or export it again.")
    sizes = [int(n) for n in header["sizes"]]
    if len(sizes) != header["dimension"]:
        raise InputError(f"{path} has {header['dimension']} dimensions, but {len(sizes)} sizes.")
    dtype = _dtype(path, header)
    size = claimed_bytes(sizes, dtype.itemsize, str(path))
    _skip_lines(path, file, int(header.get("line skip", 0)))
    skip, encoding = int(header.get("byte skip", 0)), str(header["encoding"]).lower()
    if skip < -1:
        raise InputError(f"{path} has the byte skip {skip}, expected -1 or more.")
    held = path.stat().st_size - file.tell()
    if encoding == "raw":
        check_stored(size + max(skip, 0), held, 1, str(path))
        file.seek(held - size if skip < 0 else skip, 1)
        values = np.fromfile(file, dtype)
    elif encoding in _TEXT:
        check_stored(size // dtype.itemsize, held, 1, str(path))
        file.seek(max(skip, 0), 1)
        values = np.fromfile(file, dtype, sep=" ")
    else:
        values = np.frombuffer(_expanded(path, file, encoding, size, skip, held), dtype)
    if values.size * dtype.itemsize != size:
        raise InputError(
            f"{path} has {values.size} voxels, but its header states {size // dtype.itemsize}. "
            "It is cut short or damaged; copy or export it again."
        )
    return values.reshape(sizes[::-1]).T


def _dtype(path: Path, header: dict[str, Any]) -> np.dtype[Any]:
    kind = str(header["type"]).lower()
    if kind not in _CODES:
        raise InputError(f"{path} has voxels of type {kind[:40]!r}, expected a type such as uint8.")
    code = _CODES[kind]
    text = str(header["encoding"]).lower() in _TEXT
    if code.endswith("1") or text:
        return np.dtype(code)
    if header.get("endian") not in ("big", "little"):
        raise InputError(f"{path} does not specify whether it is big or little endian.")
    return np.dtype(("<" if header["endian"] == "little" else ">") + code)


def _skip_lines(path: Path, file: BinaryIO, count: int) -> None:
    if count < 0:
        raise InputError(f"{path} has the line skip {count}, expected 0 or more.")
    for _ in range(count):
        if not file.readline():
            raise InputError(f"{path} is cut short: its line skip is {count}.")


def _expanded(
    path: Path, file: BinaryIO, encoding: str, size: int, skip: int, held: int
) -> bytearray:
    """Return decompressed voxels; nothing beyond the size in the header is decompressed."""
    if encoding not in _GZIP + _BZIP2:
        raise InputError(
            f"{path} has the encoding {encoding[:40]!r}, expected raw, gzip, bzip2 or text."
        )
    before = max(skip, 0)
    check_stored(size + before, held, DEFLATE if encoding in _GZIP else BZIP2, str(path))
    zipped = encoding in _GZIP
    stream: Any = gzip.GzipFile(fileobj=file) if zipped else io.BufferedReader(Bzip2Stream(file))
    while before > 0 and (passed := len(stream.read(min(before, 2**20)))):
        before -= passed
    out = bytearray(size)
    view, done = memoryview(out), 0
    while done < size and (count := stream.readinto(view[done : done + 2**20])):
        done += count
    more = stream.read(1)  # at the end of the stream its checksum and length are compared
    if done < size or more:
        stated = "fewer" if done < size else "more"
        raise ValueError(f"it holds {stated} voxels than its header states, {size} bytes")
    return out


_FRAMES: dict[str, FloatArray] = {
    "left-posterior-superior": np.eye(3),
    "lps": np.eye(3),
    "right-anterior-superior": RAS_TO_LPS,
    "ras": RAS_TO_LPS,
    "left-anterior-superior": np.diag([1.0, -1.0, 1.0]),
    "las": np.diag([1.0, -1.0, 1.0]),
    "scanner-xyz": np.eye(3),
    "3d-right-handed": np.eye(3),
    "": np.eye(3),
}
_ANATOMICAL = {name for name in _FRAMES if name.startswith(("left", "right", "lps", "ras", "las"))}
_SEGMENT = re.compile(r"Segment(\d+)_(Name|ID|LabelValue|Layer)")
FRAME_KEY, PLACE_KEY = "palpate_frame_uid", "palpate_place_known"
"""Keys used by `service.export` for data without an NRRD field."""
_UNIT_MM = {"": 1.0, "mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "micron": 1e-3}


def read_nrrd(path: Path) -> Scan:
    """Read an ``.nrrd`` file, or ``.nhdr`` with a separate data file."""
    what = str(path)
    values, header = read_nrrd_file(path)
    segments = _segments(header)
    _refuse_layers(segments, header, values.shape, what)
    scan = (
        _without_directions(values, header, what)
        if header.get("space directions") is None
        else _with_directions(values, header, what)
    )
    return replace(
        scan,
        frame_uid=str(header.get(FRAME_KEY, "")),
        place_known=scan.place_known and header.get(PLACE_KEY) != "false",
        names=_names(segments, what),
    )


def _without_directions(values: NDArray[Any], header: Mapping[str, Any], what: str) -> Scan:
    given = [key for key in ("space origin", "axis mins", "axis maxs") if key in header]
    if given:
        raise InputError(
            f"{what} has {' and '.join(given)} but no space directions, so the position of its "
            "voxels is ambiguous. Save it with space directions (3D Slicer and ITK always do), or "
            f"remove {' and '.join(given)} from the header."
        )
    sizes = values.shape
    spacing = np.asarray(header.get("spacings", np.full(len(sizes), np.nan)), dtype=float)
    values = three_axes(values, what)
    if spacing.size > 3:
        spacing = spacing[np.array(sizes) > 1]
    unit = _unit_mm(header, what)
    return Scan.without_frame(values, unit * spacing if spacing.size == 3 else None)


def _with_directions(values: NDArray[Any], header: dict[str, Any], what: str) -> Scan:
    steps = np.asarray(header["space directions"], dtype=float)
    spatial = _spatial_axes(steps, header, values.shape, what)
    values = values.squeeze(tuple(a for a in range(values.ndim) if a not in spatial))
    _refuse_other_spacings(steps[spatial], header.get("spacings"), spatial, what)
    unit = _unit_mm(header, what)
    origin = np.asarray(header.get("space origin", np.full(3, np.nan)), dtype=float)
    frame = _frame(header, what)
    scan = Scan.with_steps(values, unit * steps[spatial].T, unit * origin, frame)
    return replace(scan, anatomical=_space(header) in _ANATOMICAL)


def _refuse_other_spacings(steps: FloatArray, spacings: Any, spatial: list[int], what: str) -> None:
    """Raise InputError if the header also has ``spacings`` that contradict the directions."""
    if spacings is None:
        return
    stated = np.asarray(spacings, dtype=float)[spatial]
    length = np.linalg.norm(steps, axis=1)
    both = np.isfinite(stated) & np.isfinite(length)
    if np.any(np.abs(stated - length)[both] > SPACING_TOLERANCE * length[both]):
        raise InputError(
            f"{what} is inconsistent: voxels measure {_listed(length)} according to its space "
            f"directions, but {_listed(stated)} according to its spacings. "
            "Save it again with space directions alone."
        )


def _listed(lengths: FloatArray) -> str:
    return " x ".join(f"{length:.4g}" for length in lengths)


def _segments(header: Mapping[str, Any]) -> dict[int, dict[str, str]]:
    """Return the fields of each segment of a ``.seg.nrrd``, by segment number."""
    segments: dict[int, dict[str, str]] = {}
    for key, value in header.items():
        if match := _SEGMENT.fullmatch(key):
            segments.setdefault(int(match[1]), {})[match[2]] = str(value).strip()
    return segments


def _refuse_layers(
    segments: Mapping[int, Mapping[str, str]],
    header: Mapping[str, Any],
    shape: tuple[int, ...],
    what: str,
) -> None:
    named = {segment.get("Layer", "0") for segment in segments.values()}
    layers = max([len(named), *_list_sizes(header, shape)])
    if segments and layers > 1:
        raise InputError(
            f"{what} has segments in {layers} layers, because they overlap; a voxel can have one "
            "label only. In 3D Slicer, set masking to 'Overwrite: all' or "
            "remove the overlap (Logical operators: subtract), then export it as a label map: "
            "Segment Editor, Segmentations, 'Export visible segments to binary labelmap', and "
            "save that as .nrrd with its colour table (give it with --labels FILE.ctbl)."
        )


def _list_sizes(header: Mapping[str, Any], shape: tuple[int, ...]) -> list[int]:
    """Return the sizes of axes beyond three that have no direction, such as a list of layers."""
    steps = header.get("space directions")
    if steps is None or len(shape) < 4:
        return []
    return [n for n, step in zip(shape, steps, strict=False) if np.isnan(step).any()]


def _names(segments: Mapping[int, Mapping[str, str]], what: str) -> dict[int, str]:
    """Return the name of each label value."""
    names: dict[int, str] = {}
    for number, segment in sorted(segments.items()):
        name = segment.get("Name") or segment.get("ID", "")
        value = segment.get("LabelValue", "1" if len(segments) == 1 else "")
        if not value.lstrip("-").isdecimal():
            raise InputError(
                f"{what}: Segment{number}_LabelValue is {value!r}, expected the label of the "
                f"segment {name!r}. Save the segmentation again with 3D Slicer 4.11 or later."
            )
        if names.setdefault(int(value), name) != name:
            raise InputError(
                f"{what} has two segments with label {value}, {names[int(value)]!r} and "
                f"{name!r}. Save the segmentation again."
            )
    return {value: name for value, name in names.items() if name}


def _spatial_axes(
    steps: FloatArray, header: dict[str, Any], shape: tuple[int, ...], what: str
) -> list[int]:
    """Return the three spatial axes; an axis without a direction must have one voxel."""
    if steps.shape != (len(shape), 3):
        raise InputError(
            f"{what} is not a 3-D image: it has {len(shape)} axes of sizes {shape} in a space of "
            f"{steps.shape[1]} dimensions; three of each are needed."
        )
    kinds = header.get("kinds", ["domain"] * len(shape))
    spatial = [axis for axis, kind in enumerate(kinds) if kind in ("domain", "space", "???")]
    if len(shape) == 3 and len(spatial) == 3:
        return spatial  # a missing direction becomes a spacing to ask for
    spatial = [axis for axis in spatial if not np.isnan(steps[axis]).all()]
    others = [size for axis, size in enumerate(shape) if axis not in spatial]
    if len(spatial) != 3 or any(size != 1 for size in others):
        raise InputError(
            f"{what} has {len(spatial)} axes in space, shape {shape}; a volume has 3, and one "
            "value per voxel. Save one channel and one time point of it."
        )
    return spatial


def _frame(header: dict[str, Any], what: str) -> FloatArray:
    space = _space(header)
    if space not in _FRAMES:
        raise InputError(
            f"{what} is in the space {space!r}, which is unknown or mirrored. "
            "Save it as left-posterior-superior (LPS)."
        )
    return _FRAMES[space]


def _space(header: Mapping[str, Any]) -> str:
    return str(header.get("space", "")).lower().removesuffix("-time")


def _unit_mm(header: Mapping[str, Any], what: str) -> float:
    units = {str(unit).strip().lower() for unit in header.get("space units", [])} or {""}
    if len(units) > 1 or not units <= _UNIT_MM.keys():
        raise InputError(
            f"{what} has the space units {sorted(units)}, expected one of mm, cm, m, um."
        )
    return _UNIT_MM[units.pop()]
