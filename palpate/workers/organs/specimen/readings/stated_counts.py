"""Checks of counts in the headers of mesh files against the file size, before reading."""

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
    """Raise InputError if a mesh file declares more points or cells than fit in its size."""
    if not path.is_file():  # the reader reports missing files
        return
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        raise InputError(
            f"{path} has {size / MIB:.0f} MiB; the limit for meshes is {LARGEST_BYTES // MIB} MiB. "
            "Simplify it first."
        )
    content = path.read_bytes()
    if path.suffix.lower() == ".stl":
        _check_stl(path, content)
        return
    for match in _KEYWORDS.finditer(content):
        for digits in match[1].split():
            # A count, or the number of a node or a group, which cannot exceed the size of the file.
            if len(digits) > 15 or abs(int(digits)) > max(size, 2**31):
                raise InputError(
                    f"{path} has {size} bytes, but contains the count or number "
                    f"{digits[:20].decode()}. It is damaged; export it again."
                )
            if abs(int(digits)) > size and match[0].lstrip()[:1] != b"$":
                raise InputError(
                    f"{path} declares {int(digits)} points or cells, but has only {size} bytes. It "
                    "is cut short or damaged; export it again."
                )


def _check_stl(path: Path, content: bytes) -> None:
    """Check the number of facets of a binary STL file; a text file declares none."""
    if content[:5].lower() == b"solid" and b"facet" in content[:1024].lower():
        return
    if len(content) < _STL_HEADER:
        raise InputError(
            f"{path} is not an STL file: it has {len(content)} bytes. Export it again."
        )
    (facets,) = struct.unpack_from("<I", content, 80)
    if _STL_HEADER + _STL_FACET * facets > len(content):
        raise InputError(
            f"{path} declares {facets} facets, which need {_STL_FACET * facets} bytes, but has "
            f"only {len(content)} bytes. It is cut short; export it again."
        )
