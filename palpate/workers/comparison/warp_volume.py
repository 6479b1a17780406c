"""Deformed images: every voxel is looked up at its position in the reference.

Each voxel of the deformed body is in one deformed tetrahedron. The affine map of that element
maps the voxel's centre back to the reference image, where it gets the label of the nearest voxel
(`warp_labels`) or the grey value between eight voxels (`warp_grey`); `displacement_image` gives
it the displacement of its tissue. `workers.comparison.rasterisation` assigns each voxel to one
tetrahedron, so that none is missed and none is written twice.

Tissue voxels of the reference outside the mesh (a mesh is smoother than voxels) are in no
element and hence not in the result. With zero displacement every voxel whose centre is inside
the mesh keeps its value exactly. A centre exactly on the outside of the mesh counts as inside on
the low sides and as outside on the high sides.

Folded elements (volume <= 0 after deformation) write nothing. That leaves no hole: around a
folded element the upright ones overlap, and they cover its region at least twice; the last one
in the mesh wins.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Volume
from palpate.workers.comparison.rasterisation import (
    DeformedMesh,
    index_coordinates,
    place_on_lattice,
    signed_volume,
    tet_runs,
)
from palpate.workers.kernels_and_threads import EXACT

# A point midway between two voxels gets the upper one, regardless of rounding.
HALF = 0.5 + 1e-7


def warp_labels(
    reference: Volume, mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume | None = None
) -> Volume:
    """Deform a label volume; a voxel gets the label of the nearest reference voxel.

    Parameters
    ----------
    reference : Volume
        Labels or compartment ids of the undeformed body.
    mesh : TetMesh
        Elements of the undeformed body, in the coordinates of `reference`.
    displacement_mm : ndarray, shape (n, 3)
        Displacement (x, y, z) of every node.
    lattice : Volume, optional
        Gives the spacing and the phase of the result's voxel centres
        (its box and values are not used). Default: `reference`.

    Returns
    -------
    Volume
        The tight box around the deformed body; AIR outside the elements and
        where a voxel comes from outside the box of `reference`.

    Raises
    ------
    InputError
        If the displacement does not fit the mesh, is not finite, or spreads the
        body over an absurd number of voxels.
    """
    placed = place_on_lattice(mesh, displacement_mm, reference if lattice is None else lattice)
    return placed.volume(placed_labels(placed, reference, mesh), reference)


def placed_labels(placed: DeformedMesh, reference: Volume, mesh: TetMesh) -> NDArray[np.generic]:
    """Return the labels of the voxels around a deformed mesh; see `warp_labels`."""
    values = np.ascontiguousarray(reference.values)
    out = np.full(placed.shape, Tissue.AIR, dtype=values.dtype)
    _write_nearest(
        placed.fixed,
        placed.bits,
        placed.nodes,
        index_coordinates(mesh.nodes, reference),
        placed.tets,
        placed.runs,
        values,
        out,
    )
    return out


def warp_grey(
    reference: Volume,
    mesh: TetMesh,
    displacement_mm: FloatArray,
    lattice: Volume | None = None,
    *,
    outside: float = 0.0,
) -> Volume:
    """Deform a grey volume; a voxel gets the trilinear value between reference voxels.

    Within half a voxel of the border of `reference` its outermost value is used.

    Parameters
    ----------
    reference, mesh, displacement_mm, lattice
        See `warp_labels`; the values may be of any real type.
    outside : float
        Value outside the elements and of voxels from outside `reference`.

    Returns
    -------
    Volume of float32

    Raises
    ------
    InputError
        See `warp_labels`.
    """
    deformed = place_on_lattice(mesh, displacement_mm, reference if lattice is None else lattice)
    values = np.ascontiguousarray(reference.values)
    out = np.full(deformed.shape, outside, dtype=np.float32)
    sources = index_coordinates(mesh.nodes, reference)
    _write_trilinear(
        deformed.fixed,
        deformed.bits,
        deformed.nodes,
        sources,
        deformed.tets,
        deformed.runs,
        values,
        out,
    )
    return deformed.volume(out, reference)


@njit(**EXACT)
def _pull_back(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    t: int,
    six_volumes: int,
    m: FloatArray,
) -> None:
    """Store in m (3, 4) the affine map from voxels of the output to voxels of the reference."""
    v0 = tets[t, 0]
    edges = np.empty((3, 3))
    det = 0.0
    step = 0.5**bits
    for attempt in range(2):
        for i in range(3):
            v = tets[t, i + 1]
            for axis in range(3):
                if attempt == 0:
                    edges[i, axis] = nodes[v, axis] - nodes[v0, axis]
                else:
                    edges[i, axis] = (fixed[v, axis] - fixed[v0, axis]) * step
        det = (
            edges[0, 0] * (edges[1, 1] * edges[2, 2] - edges[1, 2] * edges[2, 1])
            - edges[0, 1] * (edges[1, 0] * edges[2, 2] - edges[1, 2] * edges[2, 0])
            + edges[0, 2] * (edges[1, 0] * edges[2, 1] - edges[1, 1] * edges[2, 0])
        )
        # An element nearly as flat as the grid step: only its snapped shape is surely upright.
        if det > 0.5 * six_volumes * step**3:
            break
    for axis in range(3):
        for k in range(3):
            total = 0.0
            for i in range(3):
                j, n = (i + 1) % 3, (i + 2) % 3
                p, q = (k + 1) % 3, (k + 2) % 3
                cofactor = edges[j, p] * edges[n, q] - edges[j, q] * edges[n, p]
                total += (sources[tets[t, i + 1], axis] - sources[v0, axis]) * cofactor
            m[axis, k] = total / det
        m[axis, 3] = (
            sources[v0, axis]
            - m[axis, 0] * nodes[v0, 0]
            - m[axis, 1] * nodes[v0, 1]
            - m[axis, 2] * nodes[v0, 2]
        )


@njit(**EXACT)
def runs_and_map(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    t: int,
    runs: IntArray,
    m: FloatArray,
) -> int:
    """List the runs of an element and store its map m (3, 4); a folded element has no runs."""
    six_volumes = signed_volume(fixed, tets, t)
    if six_volumes <= 0:
        return 0
    count = tet_runs(fixed, tets, t, bits, runs)
    if count > 0:
        _pull_back(fixed, bits, nodes, sources, tets, t, six_volumes, m)
    return count


@njit(**EXACT)
def _within(sources: FloatArray, tets: IntArray, t: int, shape: tuple[int, ...]) -> bool:
    """Return True if an element is inside the reference box, so that no voxel needs a check."""
    for corner in range(4):
        for axis in range(3):
            x = sources[tets[t, corner], axis]
            if x < -0.499 or x > shape[2 - axis] - 0.501:
                return False
    return True


@njit(**EXACT)
def _write_nearest(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    runs: IntArray,
    values: NDArray[np.generic],
    out: NDArray[np.generic],
) -> None:
    nz, ny, nx = values.shape
    flat = values.reshape(-1)
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        count = runs_and_map(fixed, bits, nodes, sources, tets, t, runs, m)
        if count == 0:
            continue
        inside = _within(sources, tets, t, values.shape)
        dx, dy, dz = m[0, 0], m[1, 0], m[2, 0]
        for r in range(count):
            z, y = runs[r, 0], runs[r, 1]
            # Half a voxel is added once here so that truncation rounds to the nearest.
            x_line = m[0, 1] * y + m[0, 2] * z + m[0, 3] + HALF
            y_line = m[1, 1] * y + m[1, 2] * z + m[1, 3] + HALF
            z_line = m[2, 1] * y + m[2, 2] * z + m[2, 3] + HALF
            line = out[z, y]
            if inside:
                for x in range(runs[r, 2], runs[r, 3]):
                    ix = np.int64(x_line + dx * x)
                    iy = np.int64(y_line + dy * x)
                    iz = np.int64(z_line + dz * x)
                    line[x] = flat[(iz * ny + iy) * nx + ix]
            else:
                for x in range(runs[r, 2], runs[r, 3]):
                    sx = x_line + dx * x
                    sy = y_line + dy * x
                    sz = z_line + dz * x
                    if 0 <= sx < nx and 0 <= sy < ny and 0 <= sz < nz:
                        line[x] = values[np.int64(sz), np.int64(sy), np.int64(sx)]
                    else:
                        line[x] = 0


@njit(**EXACT)
def _cell(s: float, n: int) -> tuple[int, int, float]:
    """Return lower and upper voxel around s and the weight of the upper, clamped at the border."""
    s = min(max(s, 0.0), n - 1.0)
    low = int(s)
    return low, min(low + 1, n - 1), s - low


@njit(**EXACT)
def _trilinear(values: NDArray[np.generic], sx: float, sy: float, sz: float) -> float:
    nz, ny, nx = values.shape
    x0, x1, fx = _cell(sx, nx)
    y0, y1, fy = _cell(sy, ny)
    z0, z1, fz = _cell(sz, nz)
    a = values[z0, y0, x0] * (1 - fx) + values[z0, y0, x1] * fx
    b = values[z0, y1, x0] * (1 - fx) + values[z0, y1, x1] * fx
    c = values[z1, y0, x0] * (1 - fx) + values[z1, y0, x1] * fx
    d = values[z1, y1, x0] * (1 - fx) + values[z1, y1, x1] * fx
    return (a * (1 - fy) + b * fy) * (1 - fz) + (c * (1 - fy) + d * fy) * fz


@njit(**EXACT)
def _write_trilinear(
    fixed: NDArray[np.int64],
    bits: int,
    nodes: FloatArray,
    sources: FloatArray,
    tets: IntArray,
    runs: IntArray,
    values: NDArray[np.generic],
    out: NDArray[np.float32],
) -> None:
    nz, ny, nx = values.shape
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        count = runs_and_map(fixed, bits, nodes, sources, tets, t, runs, m)
        for r in range(count):
            z, y = runs[r, 0], runs[r, 1]
            line = out[z, y]
            for x in range(runs[r, 2], runs[r, 3]):
                sx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
                sy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
                sz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                if -0.5 <= sx < nx - 0.5 and -0.5 <= sy < ny - 0.5 and -0.5 <= sz < nz - 0.5:
                    line[x] = _trilinear(values, sx, sy, sz)


def displacement_image(mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume) -> Volume:
    """Return the magnitude of the displacement on the lattice of a deformed body.

    The position before deformation is a linear image over the box of the mesh, defined exactly by
    its eight corners; it is deformed like a grey-value image.

    Parameters
    ----------
    mesh : TetMesh
        Mesh at rest, with n nodes.
    displacement_mm : ndarray, shape (n, 3)
    lattice : Volume
        See `warp_labels`.

    Returns
    -------
    Volume of float32
        Displacement in mm; nan outside the elements.
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    span = np.maximum(high - low, 1e-6)
    corners = np.indices((2, 2, 2))[::-1]  # x, y and z of [z, y, x]
    squares = 0.0
    for axis in range(3):
        values = (low[axis] + span[axis] * corners[axis]).astype(np.float64)
        (dx, dy, dz), (x, y, z) = span.tolist(), low.tolist()
        position = Volume(values, (dx, dy, dz), (x, y, z))
        before = warp_grey(position, mesh, displacement_mm, lattice, outside=np.nan)
        along = np.arange(before.shape_xyz[axis]) * before.spacing_mm[axis]
        shape = [1, 1, 1]
        shape[2 - axis] = -1
        now = before.origin_mm[axis] + along.reshape(shape)
        squares = squares + (now - before.values) ** 2
    return before.__class__(
        np.sqrt(squares).astype(np.float32), before.spacing_mm, before.origin_mm
    )
