"""Counts in the headers of mesh files, compared with the size of the file before it is read."""

import re
import struct
from pathlib import Path

from palpate.storage.errors import InputError
from palpate.workers.input_files import MIB

LARGEST_BYTES = 512 * MIB
_STL_HEADER, _STL_FACET = 84, 50
_KEYWORDS = re.compile(
    rb"^\s*(?:POINTS|CELLS|CELL_TYPES|POLYGONS|POINT_DATA|CELL_DATA|FIELD|element \w+|\$Nodes|"
    rb"\$Elements|\$Entities|\$PhysicalNames|Vertices|Tetrahedra|Triangles|Hexahedra)"
    rb"[ \t\r]*\n?([ \t\d-]*)",
    re.MULTILINE | re.IGNORECASE,
)


def check_counts(path: Path) -> None:
    """Raise InputError if a mesh file states more points or cells than its bytes can hold."""
    if not path.is_file():  # what is missing is explained by the reader
        return
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise InputError(
            f"{path} has {size / MIB:.0f} MiB; meshes of up to {LARGEST_BYTES // MIB} MiB are read "
            "here. Simplify it first."
        )
    content = path.read_bytes()
    if path.suffix.lower() == ".stl":
        _check_stl(path, content)
        return
    for match in _KEYWORDS.finditer(content):
        for digits in match[1].split():
            # A count, or the number of a node or a group: none is larger than the file.
            if len(digits) > 15 or abs(int(digits)) > max(size, 2**31):
                raise InputError(
                    f"{path} states {digits[:20].decode()} in a file of {size} bytes. It is "
                    "damaged; export it again."
                )
            if abs(int(digits)) > size and match[0].lstrip()[:1] != b"$":
                raise InputError(
                    f"{path} states {int(digits)} points or cells in a file of {size} bytes. It is "
                    "cut short or damaged; export it again."
                )


def _check_stl(path: Path, content: bytes) -> None:
    """Check the number of facets of a binary file; a text has as many as it lists."""
    if content[:5].lower() == b"solid" and b"facet" in content[:1024].lower():
        return
    if len(content) < _STL_HEADER:
        raise InputError(f"{path} is no STL file: it has {len(content)} bytes. Export it again.")
    (facets,) = struct.unpack_from("<I", content, 80)
    if _STL_HEADER + _STL_FACET * facets > len(content):
        raise InputError(
            f"{path} states {facets} facets, which need {_STL_FACET * facets} bytes, and has "
            f"{len(content)} bytes. It is cut short; export it again."
        )
