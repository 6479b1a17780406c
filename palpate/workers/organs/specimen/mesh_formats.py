"""Mesh files of all formats as points and cells, complete or refused.

The counts in the headers of a file are checked against its size before reading, and what was read
against these counts after it: readers skip what they do not know without a word.
"""

import io
import re
import struct
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.input_files import MIB, check_regular, reason_of
from palpate.workers.organs.specimen.mesh_text_files import check_nastran, read_deck, read_obj

LARGEST_BYTES = 512 * MIB
NASTRAN = (".bdf", ".nas", ".fem")
TEXT_READERS = {".inp": read_deck, ".obj": read_obj}
SUFFIXES = (
    ".stl", ".vtk", ".vtu", ".msh", ".inp", ".mesh", ".ply", ".obj", ".off", ".bdf", ".nas", ".fem",
)  # fmt: skip
_STL_HEADER, _STL_FACET = 84, 50
_KEYWORDS = re.compile(
    rb"^\s*(?:POINTS|CELLS|CELL_TYPES|POLYGONS|POINT_DATA|CELL_DATA|FIELD|element \w+|\$Nodes|"
    rb"\$Elements|\$Entities|\$PhysicalNames|Vertices|Tetrahedra|Triangles|Hexahedra)"
    rb"[ \t\r]*\n?([ \t\d-]*)",
    re.MULTILINE | re.IGNORECASE,
)


def check_counts(path: Path) -> None:
    """Raise InputError if a mesh file declares more points or cells than fit in its size."""
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
    beyond = len(content) - _STL_HEADER - _STL_FACET * facets
    if beyond:
        raise InputError(
            f"{path} declares {facets} facets, but {beyond} bytes follow them, perhaps a second "
            "solid. Export all of it as one solid."
        )


class StatedCounts(NamedTuple):
    """Numbers of points and cells in the headers of a file, summed over its pieces.

    Parameters
    ----------
    points, cells : int or None
        None if the format does not state them.
    pieces : int
        Parts of the file with points of their own.
    """

    points: int | None
    cells: int | None
    pieces: int


_MEDIT_CELLS = (
    rb"(?:Edges|Triangles|Quadrilaterals|Tetrahedra|Prisms|Pyramids|Hexahedra|Hexaedra)(?:P\d)?"
)
_NASTRAN_CELLS = rb"C(?:TETRA|PYRAM?|PENTA|HEXA|TRIA[36RX]|QUAD[489R]|TRAX|SHEAR)"
# Patterns of the number of points and of cells in a file, by its suffix.
_STATED: dict[str, tuple[bytes, bytes]] = {
    ".vtu": (
        rb"<Piece\b[^>]*\bNumberOfPoints\s*=\s*[\"'](\d+)",
        rb"<Piece\b[^>]*\bNumberOfCells\s*=\s*[\"'](\d+)",
    ),
    ".vtk": (rb"^POINTS\s+(\d+)", rb"^CELLS\s+(\d+)"),
    ".mesh": (rb"^\s*Vertices\s+(\d+)", rb"^\s*" + _MEDIT_CELLS + rb"\s+(\d+)"),
    ".ply": (rb"^element vertex\s+(\d+)", rb"^element face\s+(\d+)"),
    ".off": (rb"^OFF\s+(?:#.*\s+)*(\d+)", rb"^OFF\s+(?:#.*\s+)*\d+\s+(\d+)"),
    **dict.fromkeys((".bdf", ".nas", ".fem"), (rb"^(GRID\b)", rb"^(" + _NASTRAN_CELLS + rb"\b)")),
}


def stated_counts(path: Path) -> StatedCounts:
    """Return the numbers of points and cells that a file states."""
    content, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".msh":
        return _gmsh_counts(content)
    if suffix == ".stl":
        text = content[:5].lower() == b"solid" and b"facet" in content[:1024].lower()
        facets = len(re.findall(rb"^\s*facet\b", content, re.MULTILINE | re.IGNORECASE))
        return StatedCounts(None, facets if text else None, 1)
    if suffix not in _STATED:
        return StatedCounts(None, None, 1)
    points, cells = (
        re.findall(pattern, content, re.MULTILINE | re.IGNORECASE) for pattern in _STATED[suffix]
    )
    if suffix in (".bdf", ".nas", ".fem"):  # a line for each
        return StatedCounts(len(points), len(cells), 1)
    # The cells of version 5.1 are stated as offsets, one more than cells.
    extra = len(cells) if content.startswith(b"# vtk DataFile Version 5") else 0
    return StatedCounts(
        sum(map(int, points)) if points else None,
        sum(map(int, cells)) - extra if cells else None,
        len(points),
    )


def _gmsh_counts(content: bytes) -> StatedCounts:
    """Return the counts of a Gmsh file: one number in version 2, after that of blocks in 4."""
    heading = re.search(rb"\$MeshFormat\s+(\d+)[.\d]*\s+([01])", content)
    if heading is None:
        return StatedCounts(None, None, 1)
    new, binary = int(heading[1]) >= 4, heading[2] == b"1"
    counts = []
    for section in (b"Nodes", b"Elements"):
        found = 0
        starts = [
            m.end() for m in re.finditer(rb"^\$" + section + rb"\s*?\n", content, re.MULTILINE)
        ]
        for start in starts:
            if new and binary:
                found += struct.unpack_from("<Q", content, start + 8)[0]
            else:
                found += int(content[start : start + 80].split(None, 2)[1 if new else 0])
        counts.append((found, len(starts)))
    (points, pieces), (cells, _) = counts
    return StatedCounts(points, cells, pieces)


def read_cells(path: Path) -> meshio.Mesh:
    """Read the points and cells of a mesh file.

    Raises
    ------
    InputError
        If the file cannot be read, or not all of it was.
    """
    check_regular(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:  # other formats consist of several files
        raise InputError(
            f"{path} is not in a supported mesh format: expected {', '.join(SUFFIXES)}."
        )
    if not path.is_file():
        raise InputError(f"{path} is not a file. Check the path of the mesh.")
    if suffix in NASTRAN:
        check_nastran(path)
    check_counts(path)
    if suffix in TEXT_READERS:
        return TEXT_READERS[suffix](path)
    mesh = _read_by_library(path)
    _check_complete(path, mesh)
    return mesh


def _read_by_library(path: Path) -> meshio.Mesh:
    said = io.StringIO()
    try:
        # meshio prints errors, and may misread the header of a text as a count.
        with redirect_stdout(said), redirect_stderr(said), np.errstate(all="ignore"):
            return meshio.read(path)
    except (Exception, SystemExit) as error:  # damaged files raise almost any error
        why = " ".join(said.getvalue().split()) or f"{type(error).__name__}: {reason_of(error)}"
        raise InputError(
            f"{path} cannot be read as a mesh: it is damaged, or {path.suffix} of this form is not "
            f"supported. Export it again, as one unstructured grid in .vtk or .msh, or as a closed "
            f"surface in .stl. The reader says: {why.rstrip('.')}."
        ) from error


def _check_complete(path: Path, mesh: meshio.Mesh) -> None:
    """Refuse a file of which points or cells are missing after reading."""
    stated = stated_counts(path)
    points, cells = len(mesh.points), sum(len(block.data) for block in mesh.cells)
    if stated.points in (None, points) and stated.cells in (None, cells):
        return
    pieces = f"{stated.pieces} pieces with " if stated.pieces > 1 else ""
    states, arrived = (
        " and ".join(f"{n} {what}" for n, what in pairs if n is not None)
        for pairs in (
            ((stated.points, "points"), (stated.cells, "cells")),
            ((points if stated.points is not None else None, "points"), (cells, "cells")),
        )
    )
    raise InputError(
        f"{path} states {pieces}{states}, but {arrived} can be read. Merge all pieces into one "
        "unstructured grid, without cells of other kinds, and export it again, for instance as "
        ".vtk or .msh."
    )
