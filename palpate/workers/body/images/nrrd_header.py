"""Reader of NRRD files: the header line by line, then the voxels, and nothing else.

The known fields are listed here (http://teem.sourceforge.net/nrrd/format.html); pynrrd only
parses their values. The voxels are in the file itself. A separate header, with the suffix
``.nhdr``, names the file with the voxels; in any other file the field ``data file`` is refused.
"""

import bz2
import gzip
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import nrrd
import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.body.images.claimed_size import BZIP2, DEFLATE, check_stored, claimed_bytes
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
        found = keys if value.startswith("=") else fields
        name = key if found is keys else _field(key)
        if not mark or name is None or (found is keys and _field(key) is not None):
            _refuse_line(path, number, text)
        if name in found:
            raise InputError(f"{path}, line {number}: {name!r} is given twice. Keep one line.")
        found[name] = value.removeprefix("=").strip()
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
    stream: Any = gzip.GzipFile(fileobj=file) if encoding in _GZIP else bz2.BZ2File(file)
    while before > 0 and (passed := len(stream.read(min(before, 2**20)))):
        before -= passed
    out = bytearray(size)
    view, done = memoryview(out), 0
    while done < size and (count := stream.readinto(view[done : done + 2**20])):
        done += count
    more = b""
    with suppress(OSError, EOFError):  # bytes after the stream are not voxels
        more = stream.read(1)
    if done < size or more:
        stated = "fewer" if done < size else "more"
        raise ValueError(f"it holds {stated} voxels than its header states, {size} bytes")
    return out
