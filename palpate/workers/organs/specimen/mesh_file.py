"""Body in a mesh file as tetrahedra or triangles, without unsupported content.

Hexahedra, wedges, pyramids and pixels are split; nodes on the edges of cells are ignored. If a
file contains volume cells, they are the body, and its surface cells are left out.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.input_files import reading
from palpate.workers.organs.specimen.mesh_formats import read_cells

Indices = NDArray[np.int64]

# Number of corners of each volume cell, and the corners of its faces.
_TETRA = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
_PYRAMID = ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))
_WEDGE = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
_BRICK = (
    (0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
)  # fmt: skip
_VOXEL = tuple(tuple((0, 1, 3, 2, 4, 5, 7, 6)[c] for c in face) for face in _BRICK)
VOLUMES: dict[str, tuple[int, tuple[tuple[int, ...], ...]]] = {
    **dict.fromkeys(("tetra", "tetra10"), (4, _TETRA)),
    **dict.fromkeys(("pyramid", "pyramid13", "pyramid14"), (5, _PYRAMID)),
    **dict.fromkeys(("wedge", "wedge15", "wedge18"), (6, _WEDGE)),
    **dict.fromkeys(("hexahedron", "hexahedron20", "hexahedron24", "hexahedron27"), (8, _BRICK)),
    "voxel": (8, _VOXEL),
}
SURFACES: dict[str, tuple[tuple[int, int, int], ...]] = {
    **dict.fromkeys(("triangle", "triangle6", "triangle7"), ((0, 1, 2),)),
    **dict.fromkeys(("quad", "quad8", "quad9"), ((0, 1, 2), (0, 2, 3))),
    "pixel": ((0, 1, 3), (0, 3, 2)),
}
NO_BODY = ("vertex", "line")
# Cells below this fraction of the mean volume are flat.
FLAT = 1e-12
FARTHEST_MM = 1e6


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The body in a mesh file.

    Parameters
    ----------
    corners : ndarray, shape (m, 4, 3) or (m, 3, 3)
        Corners of tetrahedra, or of the triangles of a surface, in mm.
    cell : ndarray of int, shape (m,)
        Cell of the file to which each belongs, counted over all blocks of volume cells.
    labels : dict of str to ndarray
        Data of all volume cells of the file.
    same : ndarray of int
        First volume cell of the file with the same corners, for each of them.
    notes : tuple of str
        Notes on parts of the file that were left out.
    """

    corners: FloatArray
    cell: Indices
    labels: dict[str, FloatArray]
    same: Indices
    notes: tuple[str, ...]

    @property
    def is_solid(self) -> bool:
        """Whether the file contains volume cells."""
        return self.corners.shape[1] == 4

    @property
    def size_mm(self) -> FloatArray:
        """Sides of the box around the body, shape (3,)."""
        return np.ptp(self.corners.reshape(-1, 3), axis=0)

    @property
    def volume_mm3(self) -> float | None:
        """Volume of the body; None for a surface whose facets do not all face outwards."""
        if self.is_solid:
            edges = self.corners[:, 1:] - self.corners[:, :1]
            return float(np.abs(np.linalg.det(edges)).sum()) / 6
        if not _is_oriented(self.corners):
            return None
        middle = self.corners.reshape(-1, 3).mean(axis=0)
        return abs(float(np.linalg.det(self.corners - middle).sum())) / 6


def read_mesh_file(path: Path, mm_per_unit: float) -> MeshFile:
    """Read the body of a mesh file.

    Raises
    ------
    InputError
        If the file cannot be read, or its cells and points do not form a body.
    """
    with reading(path, "a mesh"):
        return _body(path, read_cells(path), mm_per_unit)


def _body(path: Path, mesh: meshio.Mesh, mm_per_unit: float) -> MeshFile:
    blocks = [(b.type, np.asarray(b.data)) for b in mesh.cells if len(b.data)]
    _check_kinds(path, blocks)
    points = _points(path, mesh, mm_per_unit)
    solid = [n for n, block in enumerate(mesh.cells) if block.type in VOLUMES and len(block.data)]
    if solid:
        return _solid(path, mesh, points, solid)
    return _surface(path, points, [(kind, data) for kind, data in blocks if kind in SURFACES])


def _check_kinds(path: Path, blocks: list[tuple[str, Indices]]) -> None:
    counts = Counter[str]()
    for kind, data in blocks:
        counts[kind] += len(data)
    unread = {
        kind: count
        for kind, count in counts.items()
        if kind not in VOLUMES and kind not in SURFACES and not kind.startswith(NO_BODY)
    }
    if unread:
        cells = ", ".join(f"{count} {kind}" for kind, count in unread.items())
        raise InputError(
            f"{path} has unsupported cells: {cells}. Supported are {', '.join(VOLUMES)} and, in "
            "files without these, surfaces of triangles and quadrilaterals. Convert the cells."
        )
    if not set(counts) & (set(VOLUMES) | set(SURFACES)):
        cells = ", ".join(counts) or "no cells"
        raise InputError(
            f"{path} must have volume cells such as tetrahedra, or a surface of triangles; found "
            f"{cells}."
        )


def _points(path: Path, mesh: meshio.Mesh, mm_per_unit: float) -> FloatArray:
    points = np.asarray(mesh.points, np.float64) * mm_per_unit
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path} is flat: its points have {points.shape[-1]} coordinates, not 3.")
    return np.where(np.abs(points) <= FARTHEST_MM, points, np.nan)


def _checked(path: Path, kind: str, data: Indices, points: FloatArray) -> Indices:
    """Return the points of cells, after checking that all exist and are finite."""
    bad = (data < 0) | (data >= len(points))
    if bad.any():
        cell = int(np.flatnonzero(bad.any(axis=1))[0])
        raise InputError(
            f"{path}: cell {cell} of {kind} refers to point {data[bad][0]}, counted from 0, but "
            f"the file has {len(points)} points. Export the mesh again."
        )
    lost = ~np.isfinite(points[data]).all(axis=2)
    if lost.any():
        raise InputError(
            f"{path}: point {data[lost][0]}, counted from 0, has coordinates that are not finite "
            f"or are more than {FARTHEST_MM:g} mm from the origin. Export the mesh again."
        )
    return data


def _solid(path: Path, mesh: meshio.Mesh, points: FloatArray, blocks: list[int]) -> MeshFile:
    """Return the volume cells as tetrahedra, each once and without flat ones."""
    corners, cells, rings, first = [], [], [], 0
    for block in (mesh.cells[n] for n in blocks):
        count, faces = VOLUMES[block.type]
        data = _checked(path, block.type, np.asarray(block.data, np.int64)[:, :count], points)
        parts, owner = _split(points, data, faces) if count > 4 else (points[data], _all(data))
        corners.append(parts)
        cells.append(owner + first)
        rings.append(data)
        first += len(data)
    every, cell = np.concatenate(corners), np.concatenate(cells)
    size = np.abs(np.linalg.det(every[:, 1:] - every[:, :1])) / 6
    whole = np.bincount(cell, size, first)
    if not whole.sum() > 0:
        raise InputError(f"{path} has {first} volume cells, all of them flat.")
    flat = whole < FLAT * whole.mean()
    same = _first_of_same(points, rings)
    again = same != _all(same)
    kept = ~flat[cell] & ~again[cell] & (size > 0)
    labels = {
        name: np.concatenate(
            [np.asarray(data[n]).reshape(len(mesh.cells[n].data), -1)[:, 0] for n in blocks]
        )
        for name, data in mesh.cell_data.items()
        if all(np.asarray(data[n]).size == len(mesh.cells[n].data) for n in blocks)
    }
    notes = tuple(_notes(path, mesh, flat, again))
    return MeshFile(every[kept], cell[kept], labels, same, notes)


def _first_of_same(points: FloatArray, rings: list[Indices]) -> Indices:
    """Return the first cell with the same corners, in any order, for each cell."""
    used, place = np.unique(np.concatenate([ring.ravel() for ring in rings]), return_inverse=True)
    _, spot = np.unique(points[used], axis=0, return_inverse=True)
    spot = spot.ravel()
    widest = max(ring.shape[1] for ring in rings)
    ends = np.cumsum([ring.size for ring in rings])
    corners = [
        np.pad(
            np.sort(part.reshape(ring.shape), axis=1),
            ((0, 0), (0, widest - ring.shape[1])),
            constant_values=-1,
        )
        for part, ring in zip(np.split(spot[place], ends[:-1]), rings, strict=True)
    ]
    _, first, group = np.unique(
        np.concatenate(corners), axis=0, return_index=True, return_inverse=True
    )
    return np.asarray(first[group.ravel()], np.int64)


def _all(data: Indices) -> Indices:
    return np.arange(len(data), dtype=np.int64)


def _split(
    points: FloatArray, data: Indices, faces: tuple[tuple[int, ...], ...]
) -> tuple[FloatArray, Indices]:
    """Return tetrahedra between the centre of each cell and its faces, and their cells.

    A face with four corners is cut through its lowest-numbered corner, as in the neighbouring
    cell, so that cells with warped faces leave no gap.
    """
    middle = points[data].mean(axis=1)
    triangles = []
    for face in faces:
        ring = data[:, face]
        if len(face) == 3:
            triangles.append(ring)
            continue
        start = ring.argmin(axis=1)[:, None]
        ring = np.take_along_axis(ring, (start + np.arange(4)) % 4, axis=1)
        triangles += [ring[:, [0, 1, 2]], ring[:, [0, 2, 3]]]
    every = np.concatenate(triangles)
    owner = np.tile(_all(data), len(triangles))
    return np.concatenate([middle[owner][:, None], points[every]], axis=1), owner


def _notes(path: Path, mesh: meshio.Mesh, flat: BoolArray, again: BoolArray) -> list[str]:
    """Return notes on cells that are not part of the body."""
    notes = []
    if again.any():
        notes.append(
            f"{int(again.sum())} of {len(again)} cells of {path.name} have the corners of an "
            "earlier one, as in files with several groups for a cell, and are counted once."
        )
    if flat.any():
        notes.append(
            f"{int(flat.sum())} of {len(flat)} cells of {path.name} are flat and left out."
        )
    beside = sum(len(block.data) for block in mesh.cells if block.type in SURFACES)
    if beside:
        notes.append(f"{beside} surface cells of {path.name} are not part of the body.")
    return notes


def _surface(path: Path, points: FloatArray, blocks: list[tuple[str, Indices]]) -> MeshFile:
    """Return the triangles of a surface, each facet once."""
    triangles = np.concatenate(
        [
            _checked(path, kind, data, points)[:, list(part)]
            for kind, data in blocks
            for part in SURFACES[kind]
        ]
    ).astype(np.int64)
    used, index = np.unique(points[triangles].reshape(-1, 3), axis=0, return_inverse=True)
    if not np.ptp(used, axis=0).all():
        raise InputError(f"{path} is flat: all its facets are in one plane. Export it again.")
    kept = _once(index.reshape(-1, 3))
    twice = len(triangles) - len(kept)
    notes = (f"{twice} facets of {path.name} are duplicates and counted once.",) if twice else ()
    return MeshFile(used[kept], _all(kept), {}, _all(kept), notes)


def _is_oriented(corners: FloatArray) -> bool:
    """Test whether each edge is passed as often in one direction as in the other."""
    used, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    start = index.reshape(-1, 3).astype(np.int64)
    end = np.roll(start, -1, axis=1)
    there, back = (np.sort((a * len(used) + b).ravel()) for a, b in ((start, end), (end, start)))
    return bool((there == back).all())


def _once(triangles: Indices) -> Indices:
    """Return facets without repetitions.

    Two opposite facets are the walls of two touching bodies, and both are kept, unless every
    facet has such a partner.
    """
    start = triangles.argmin(axis=1)[:, None]
    turned = np.take_along_axis(triangles, (start + np.arange(3)) % 3, axis=1)
    facing = np.unique(turned, axis=0)
    ways, count = np.unique(np.sort(facing, axis=1), axis=0, return_counts=True)
    return ways if (count == 2).all() else facing
