"""Readers of mesh files that are text: Abaqus decks and OBJ surfaces, with the line of each fault.

Only nodes and elements of a deck are read; whatever would move or multiply them is refused.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import meshio
import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.input_files import MIB, read_bytes

TEXT_MESH_BYTES = 512 * MIB
GENERATORS = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM", "INCLUDE"}
# Each of these may occur only once: nodes and elements of a second one may have the same numbers.
ONCE = ("PART", "INSTANCE", "NODE")
# Elements by family and number of nodes; letters behind them (hybrid, reduced ...) change no node.
_SOLID = re.compile(r"(?:C|DC|AC)3D(\d+)[A-Z]*$")
_SHELL = re.compile(r"(?:D?S|STRI|M3D|SFM3D|R3D|CPS|CPE|CAX)(\d)")
_BAR = re.compile(r"(?:T[23]D|B[23])\d")
SOLIDS = {
    4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15",
    20: "hexahedron20",
}  # fmt: skip
SHELLS = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}


def read_deck(path: Path) -> meshio.Mesh:
    """Read the nodes and elements of an Abaqus deck.

    Raises
    ------
    InputError
        With the line of the first keyword or number that cannot be read.
    """
    nodes: dict[int, list[float]] = {}
    elements: list[tuple[str, int, list[int]]] = []
    seen: dict[str, int] = {}
    keyword, left_out = "", False
    for number, line in _deck_lines(path):
        if line.startswith("*"):
            keyword, options = _keyword(line)
            _check_keyword(path, number, keyword, options, seen)
            seen.setdefault(keyword, number)
            if keyword == "ELEMENT":
                kind, count = _element(path, number, options.get("TYPE", ""))
                left_out = not kind
                elements.append((kind, count, []))
        elif keyword == "INSTANCE":
            raise _unread(path, number, "a translation or rotation of an *INSTANCE")
        elif keyword == "NODE":
            name, place = _node(path, number, line)
            nodes[name] = place
        elif keyword == "ELEMENT" and not left_out:
            elements[-1][2].extend(_whole_numbers(path, number, line))
    return _mesh_of_deck(path, nodes, elements)


def _deck_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield lines without comments, and keywords whole, each with its number."""
    held: tuple[int, str] | None = None
    for number, text in enumerate(_text(path).splitlines(), start=1):
        line = text.strip()
        if not line or line.startswith("**"):
            continue
        if held and held[1].endswith(",") and line[0].isalpha():  # it goes on in this line
            held = (held[0], held[1] + line)
            continue
        if held:
            yield held
        held = (number, line) if line.startswith("*") else None
        if not held:
            yield number, line
    if held:
        yield held


def _keyword(line: str) -> tuple[str, dict[str, str]]:
    name, *parts = (part.strip().upper() for part in line[1:].split(","))
    options = (part.partition("=") for part in parts if part)
    return name, {key.strip(): value.strip() for key, _, value in options}


def _check_keyword(
    path: Path, number: int, keyword: str, options: dict[str, str], seen: dict[str, int]
) -> None:
    moved = sorted(options.keys() & {"SYSTEM", "INPUT"})
    if keyword in GENERATORS:
        raise _unread(path, number, f"*{keyword}")
    if keyword in ("NODE", "ELEMENT") and moved:
        raise _unread(path, number, f"*{keyword} with {' and '.join(moved)}")
    if keyword in seen and keyword in ONCE:
        first = f"a second *{keyword}, after the one in line {seen[keyword]},"
        raise _unread(path, number, first)


def _unread(path: Path, number: int, why: str) -> InputError:
    return InputError(
        f"{path}, line {number}: {why} is not read. Export the mesh as one part, in global "
        "coordinates and without transformations, for instance as .vtk or .msh."
    )


def _element(path: Path, number: int, kind: str) -> tuple[str, int]:
    """Return the kind and the number of nodes of an element; no kind for a bar."""
    for family, kinds in ((_SOLID, SOLIDS), (_SHELL, SHELLS)):
        match = family.match(kind)
        if match and int(match[1]) in kinds:
            return kinds[int(match[1])], int(match[1])
    if _BAR.match(kind):
        return "", 1
    known = ", ".join(f"C3D{count}" for count in SOLIDS)
    raise InputError(
        f"{path}, line {number}: elements of TYPE={kind or 'nothing'} are not read. Bodies consist "
        f"of {known}, with any letters behind them. Convert these elements, or delete them if they "
        "are not part of the body."
    )


def _node(path: Path, number: int, line: str) -> tuple[int, list[float]]:
    name, *numbers = line.rstrip(", ").split(",")
    try:
        place = [float(text) for text in numbers[:3]]
        if len(place) == 3:
            return int(name), place
    except ValueError:
        pass
    raise InputError(
        f"{path}, line {number}: a node needs its number and three coordinates, found "
        f"{line[:60]!r}. Correct the line or export the deck again."
    )


def _whole_numbers(path: Path, number: int, line: str) -> list[int]:
    try:
        return [int(text) for text in line.split(",") if text.strip()]
    except ValueError:
        raise InputError(
            f"{path}, line {number}: an element needs whole numbers, its own and those of its "
            f"nodes, found {line[:60]!r}. Correct the line or export the deck again."
        ) from None


def _mesh_of_deck(
    path: Path, nodes: dict[int, list[float]], elements: list[tuple[str, int, list[int]]]
) -> meshio.Mesh:
    index = {name: place for place, name in enumerate(nodes)}
    cells = []
    for kind, count, numbers in elements:
        if not (kind and numbers):
            continue
        if len(numbers) % (count + 1):
            raise InputError(
                f"{path}: elements of {count} nodes ({kind}) need {count + 1} numbers each, but "
                f"their block has {len(numbers)}. It is cut short or damaged; export it again."
            )
        table = np.array(numbers).reshape(-1, count + 1)
        missing = sorted({*table[:, 1:].ravel().tolist()} - index.keys())
        if missing:
            raise InputError(
                f"{path}: its elements refer to the node {missing[0]}, which is not under *NODE "
                f"({len(missing)} such nodes). Export the deck again, with all nodes."
            )
        corners = [index[name] for name in table[:, 1:].ravel().tolist()]
        cells.append((kind, np.array(corners).reshape(-1, count)))
    return meshio.Mesh(np.array([*nodes.values()]).reshape(-1, 3), cells)


def read_obj(path: Path) -> meshio.Mesh:
    """Read the faces of an OBJ file; textures, normals, colours and groups are left out.

    Raises
    ------
    InputError
        With the line of the first vertex or face that cannot be read.
    """
    points: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {kind: [] for kind in ("triangle", "quad")}
    for number, text in enumerate(_text(path).replace("\\\n", " ").splitlines(), start=1):
        word, *rest = text.partition("#")[0].split() or [""]
        if word not in ("v", "f"):
            continue
        try:
            if word == "v":
                points.append(_vertex(rest))
            else:
                face = [_corner(item, len(points)) for item in rest]
                faces[{3: "triangle", 4: "quad"}[len(face)]].append(face)
        except (ValueError, KeyError):
            raise InputError(
                f"{path}, line {number}: found {text.strip()[:60]!r}. Expected a vertex with three "
                "coordinates, or a face with three or four corners, numbered from 1 or backwards "
                "from -1. Triangulate the surface and export it again."
            ) from None
    cells = [(kind, np.array(corners)) for kind, corners in faces.items() if corners]
    return meshio.Mesh(np.array(points).reshape(-1, 3), cells)


def _vertex(words: list[str]) -> list[float]:
    x, y, z = map(float, words[:3])  # a weight or a colour may follow
    return [x, y, z]


def _corner(item: str, points: int) -> int:
    """Return the point of a corner such as ``7``, ``7/3/5`` or ``-1``, counted from 0."""
    place = int(item.partition("/")[0])
    if place == 0 or place < -points:
        raise ValueError
    return place - 1 if place > 0 else points + place


def check_nastran(path: Path) -> None:
    """Refuse a Nastran deck with other coordinate systems or further files."""
    for number, text in enumerate(_text(path).splitlines(), start=1):
        if text.upper().startswith(("CORD", "INCLUDE")):
            raise _unread(path, number, text.split()[0].rstrip("*,"))


def _text(path: Path) -> str:
    try:
        content = read_bytes(path, TEXT_MESH_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    return content.decode("utf-8", errors="replace").replace("\r\n", "\n")
