"""Distance of voxels to a surface of triangles.

Each voxel inherits the nearest vertex of its neighbours, sweep by sweep [1]_, starting from
the voxels next to the surface. Occasionally that is the second nearest, so
close to the surface the vertices of all neighbours are compared once more, and the
triangles around the nearest give the distance: up to 0.06 voxels too far, 0.002 in
the mean. Farther away the vertex itself is used, up to 0.15 voxels too far.

References
----------
.. [1] P.-E. Danielsson, Euclidean distance mapping, Computer Graphics and Image
   Processing 14 (1980) 227-248.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.body.mesh.mesh_geometry import elements_of_nodes
from palpate.workers.kernels_and_threads import CONTRACTED

BLOCK = 16  # voxels of a line that are checked together for a nearer vertex of a neighbour
NEAR = 6.0  # voxels within which triangles are used
FAR = np.float32(1e30)

Place = tuple[float, float, float]


def distances(
    vertices: FloatArray,
    triangles: IntArray,
    shape: tuple[int, int, int],
    step: FloatArray,
    band: float,
) -> NDArray[np.float32]:
    """Return the distance of lattice points to a surface.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3)
        (x, y, z) from the first lattice point, in mm.
    triangles : ndarray of int32, shape (m, 3)
    shape : tuple of int
        Lattice points along z, y, x.
    step : ndarray, shape (3,)
        Distances of the points along x, y, z, in mm.
    band : float
        In mm; larger distances are clipped to it.

    Returns
    -------
    ndarray of float32, shape (nz, ny, nx)
        In mm, not negative.
    """
    step = np.asarray(step, np.float64)
    squared = np.full(shape, FAR, np.float32)
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    # Axis by axis, so that eight coordinates are loaded at once; the last vertex is a placeholder.
    rough = np.full((3, len(points) + 1), FAR, np.float32)
    rough[:, :-1] = points.T
    nobody = np.uint32(len(points))
    nearest = np.full(shape, nobody)
    rough_step = step.astype(np.float32)
    _seed(rough, rough_step, nearest, squared)
    reach = band + float(step.max())
    for z_step in (1, -1):
        _sweep(rough, rough_step, np.float32(reach**2), z_step, nearest, squared)
    start, content = elements_of_nodes(triangles, len(points))
    near = min(NEAR * float(step.max()), reach)
    _refine(points, triangles, start, content, step, near, nearest, squared)
    return np.minimum(np.sqrt(squared, out=squared), np.float32(band), out=squared)


@njit(**CONTRACTED)
def _seed(
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    nearest: IntArray,
    squared: NDArray[np.float32],
) -> None:
    """Propose each vertex to the voxels around it."""
    nz, ny, nx = nearest.shape
    for v in range(points.shape[1] - 1):
        x0 = int(points[0, v] / step[0] + 0.5)
        y0 = int(points[1, v] / step[1] + 0.5)
        z0 = int(points[2, v] / step[2] + 0.5)
        for z in range(max(z0 - 1, 0), min(z0 + 2, nz)):
            for y in range(max(y0 - 1, 0), min(y0 + 2, ny)):
                for x in range(max(x0 - 1, 0), min(x0 + 2, nx)):
                    # No `_offer`: its reference counting of the line takes longer than the rest.
                    d = _squared(v, points, step, z, y, x)
                    if d < squared[z, y, x]:
                        squared[z, y, x] = d
                        nearest[z, y, x] = v


@njit(**CONTRACTED)
def _sweep(
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    reach2: np.float32,
    z_step: int,
    nearest: IntArray,
    squared: NDArray[np.float32],
) -> None:
    """Sweep slices in one order; in each, lines in both orders; in each line, voxels in both."""
    nz, ny, _ = nearest.shape
    for k in range(nz):
        z = k if z_step > 0 else nz - 1 - k
        if k > 0:
            for y in range(ny):
                _across(
                    points,
                    step,
                    reach2,
                    z,
                    y,
                    nearest[z - z_step, y],
                    squared[z - z_step, y],
                    nearest[z, y],
                    squared[z, y],
                )
        for y in range(ny):
            if y > 0:
                _across(
                    points,
                    step,
                    reach2,
                    z,
                    y,
                    nearest[z, y - 1],
                    squared[z, y - 1],
                    nearest[z, y],
                    squared[z, y],
                )
            _along(points, step, reach2, z, y, nearest[z, y], squared[z, y])
        for y in range(ny - 2, -1, -1):
            _across(
                points,
                step,
                reach2,
                z,
                y,
                nearest[z, y + 1],
                squared[z, y + 1],
                nearest[z, y],
                squared[z, y],
            )
            _along(points, step, reach2, z, y, nearest[z, y], squared[z, y])


@njit(**CONTRACTED)
def _across(
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    reach2: np.float32,
    z: int,
    y: int,
    source: IntArray,
    source_squared: NDArray[np.float32],
    line: IntArray,
    squared: NDArray[np.float32],
) -> None:
    """Propose the vertices of a neighbouring line."""
    n = len(line)
    for first in range(0, n, BLOCK):
        end = min(first + BLOCK, n)
        if _is_welcome(points, step, reach2, z, y, first, end, 0, source, source_squared, squared):
            for x in range(first, end):
                if source_squared[x] < reach2 and source[x] != line[x]:
                    _offer(source[x], points, step, z, y, x, line, squared)


@njit(**CONTRACTED)
def _along(
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    reach2: np.float32,
    z: int,
    y: int,
    line: IntArray,
    squared: NDArray[np.float32],
) -> None:
    """Propose each voxel's vertex to the next one, forwards and backwards."""
    n = len(line)
    changed = False
    for first in range(1, n, BLOCK):
        end = min(first + BLOCK, n)
        if not changed and not _is_welcome(
            points, step, reach2, z, y, first, end, -1, line, squared, squared
        ):
            continue
        for x in range(first, end):
            before = line[x]
            if squared[x - 1] < reach2 and line[x - 1] != before:
                _offer(line[x - 1], points, step, z, y, x, line, squared)
            changed = line[x] != before
    changed = False
    for end in range(n - 1, 0, -BLOCK):
        first = max(end - BLOCK, 0)
        if not changed and not _is_welcome(
            points, step, reach2, z, y, first, end, 1, line, squared, squared
        ):
            continue
        for x in range(end - 1, first - 1, -1):
            before = line[x]
            if squared[x + 1] < reach2 and line[x + 1] != before:
                _offer(line[x + 1], points, step, z, y, x, line, squared)
            changed = line[x] != before


@njit(**CONTRACTED)
def _is_welcome(
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    reach2: np.float32,
    z: int,
    y: int,
    first: int,
    end: int,
    side: int,
    source: IntArray,
    source_squared: NDArray[np.float32],
    squared: NDArray[np.float32],
) -> bool:
    """Return True if any voxel of a block would take its neighbour's current vertex.

    Most proposals fail. As nothing is written here, eight are compared at once; far from the
    surface no neighbour has a vertex.
    """
    offered = 0
    for x in range(first, end):
        offered |= source_squared[x + side] < reach2
    if offered == 0:
        return False
    welcome = 0
    for x in range(first, end):
        d = _squared(source[x + side], points, step, z, y, x)
        welcome |= (d < squared[x]) & (source_squared[x + side] < reach2)
    return welcome != 0


@njit(**CONTRACTED)
def _offer(
    vertex: int,
    points: NDArray[np.float32],
    step: NDArray[np.float32],
    z: int,
    y: int,
    x: int,
    line: IntArray,
    squared: NDArray[np.float32],
) -> None:
    """Assign a vertex to a voxel if it is nearer than the present one."""
    d = _squared(vertex, points, step, z, y, x)
    if d < squared[x]:
        squared[x] = d
        line[x] = vertex


@njit(**CONTRACTED)
def _squared(
    vertex: int, points: NDArray[np.float32], step: NDArray[np.float32], z: int, y: int, x: int
) -> np.float32:
    dx = points[0, vertex] - np.float32(x) * step[0]
    dy = points[1, vertex] - np.float32(y) * step[1]
    dz = points[2, vertex] - np.float32(z) * step[2]
    return dx * dx + dy * dy + dz * dz


@njit(**CONTRACTED)
def _refine(
    points: FloatArray,
    triangles: IntArray,
    start: IntArray,
    content: IntArray,
    step: FloatArray,
    near: float,
    nearest: IntArray,
    squared: NDArray[np.float32],
) -> None:
    nz, ny, nx = nearest.shape
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                if squared[z, y, x] > near * near:
                    continue
                place = x * step[0], y * step[1], z * step[2]
                vertex = _nearest_around(place, points, z, y, x, nearest)
                least = _from_vertex(place, points, vertex)
                for a in range(start[vertex], start[vertex + 1]):
                    least = min(least, _to_triangle(place, points, triangles, content[a]))
                squared[z, y, x] = least


@njit(**CONTRACTED)
def _nearest_around(
    at: Place, points: FloatArray, z: int, y: int, x: int, nearest: IntArray
) -> np.uint32:
    """Return the nearest of the vertices of a voxel and its 26 neighbours."""
    nz, ny, nx = nearest.shape
    vertex = seen = nearest[z, y, x]
    least = _from_vertex(at, points, vertex)
    for k in range(max(z - 1, 0), min(z + 2, nz)):
        for j in range(max(y - 1, 0), min(y + 2, ny)):
            for i in range(max(x - 1, 0), min(x + 2, nx)):
                other = nearest[k, j, i]
                if other != vertex and other != seen and other < len(points):
                    seen = other
                    d = _from_vertex(at, points, other)
                    if d < least:
                        least = d
                        vertex = other
    return vertex


@njit(**CONTRACTED)
def _from_vertex(at: Place, points: FloatArray, v: int) -> float:
    return (at[0] - points[v, 0]) ** 2 + (at[1] - points[v, 1]) ** 2 + (at[2] - points[v, 2]) ** 2


@njit(**CONTRACTED)
def _to_triangle(at: Place, points: FloatArray, triangles: IntArray, number: int) -> float:
    """Return the squared distance of a point to a triangle: to its plane, or the nearest edge."""
    a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
    ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
    ux, uy, uz = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
    vx, vy, vz = points[c, 0] - ax, points[c, 1] - ay, points[c, 2] - az
    wx, wy, wz = at[0] - ax, at[1] - ay, at[2] - az
    uu, uv, vv = (
        ux * ux + uy * uy + uz * uz,
        ux * vx + uy * vy + uz * vz,
        vx * vx + vy * vy + vz * vz,
    )
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    ww = wx * wx + wy * wy + wz * wz
    area2 = uu * vv - uv * uv
    s = vv * uw - uv * vw
    t = uu * vw - uv * uw
    if s >= 0.0 and t >= 0.0 and s + t <= area2 and area2 > 1e-12 * uu * vv:
        s, t = s / area2, t / area2
        return max(ww - 2.0 * (s * uw + t * vw) + s * s * uu + 2.0 * s * t * uv + t * t * vv, 0.0)
    least = min(_to_edge(ww, uw, uu), _to_edge(ww, vw, vv))
    # The third edge starts at b: x - b = w - u, c - b = v - u.
    return min(least, _to_edge(ww - 2.0 * uw + uu, vw - uw - uv + uu, vv - 2.0 * uv + uu))


@njit(**CONTRACTED)
def _to_edge(ww: float, ew: float, ee: float) -> float:
    """Return the squared distance to an edge e from products of e and the point minus its start."""
    along = min(max(ew / ee, 0.0), 1.0) if ee > 0.0 else 0.0
    return max(ww - 2.0 * along * ew + along * along * ee, 0.0)
