"""The deformed image: every voxel asks the reference what it was before.

Each voxel of the deformed body lies in one deformed tetrahedron. The affine map
of that element takes the voxel's centre back to the reference image, where it
picks the label of the nearest voxel (`warp_labels`) or the grey value between
eight voxels (`warp_grey`). `workers.imaging.runs` decides which tetrahedron owns
a voxel, so that none is missed and none is written twice.

What does not move: tissue voxels of the reference outside the mesh (a mesh is
smoother than voxels) are in no element and hence not in the result. Under zero
displacement every voxel whose centre lies inside the mesh keeps its value
exactly. A centre exactly on the outside of the mesh counts as inside on the low
sides and as outside on the high sides.

Folded elements (volume <= 0 after deformation) write nothing. That leaves no
hole: around a folded element the upright ones overlap, and what it covers is
covered at least twice by them; the one that comes last in the mesh wins.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from storage.errors import InputError
from storage.values import FloatArray, TetMesh, Tissue, Triple, Volume
from workers.imaging.runs import fixed_point, run_buffer, signed_volume, tet_runs

MAX_VOXELS = 2**32
# A point midway between two voxels takes the upper one, whatever the last bits say.
HALF = 0.5 + 1e-7


@dataclass(frozen=True, eq=False)
class Coverage:
    """How often each voxel is written.

    Parameters
    ----------
    counts : Volume of uint8
        Number of elements that own a voxel: 1 inside a mesh without folds.
    inverted : int
        Elements of volume <= 0 after deformation, which own nothing.
    """

    counts: Volume
    inverted: int


@dataclass(frozen=True, eq=False)
class _Raster:
    """A deformed mesh seen from the voxel lattice of the output."""

    fixed: NDArray[np.int64]  # (n, 3) positions in the box, in steps of 2**-bits voxels
    bits: int
    nodes: FloatArray  # (n, 3) the same in voxels, not snapped
    tets: NDArray[np.int32]
    runs: NDArray[np.int32]
    shape: tuple[int, int, int]  # of the box, [z, y, x]
    spacing_mm: Triple
    origin_mm: Triple

    def volume(self, values: NDArray[Any]) -> Volume:
        return Volume(values, self.spacing_mm, self.origin_mm)


def warp_labels(
    reference: Volume, mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume | None = None
) -> Volume:
    """Deform a label volume; a voxel takes the label of the nearest reference voxel.

    Parameters
    ----------
    reference : Volume
        Labels or compartment ids of the undeformed body.
    mesh : TetMesh
        Elements of the undeformed body, in the coordinates of `reference`.
    displacement_mm : ndarray, shape (n, 3)
        Displacement (x, y, z) of every node.
    lattice : Volume, optional
        Its spacing and the phase of its voxel centres are those of the result
        (its box and values are not used). Default: `reference`.

    Returns
    -------
    Volume
        The tight box around the deformed body; AIR outside the elements and
        where a voxel comes from outside the box of `reference`.

    Raises
    ------
    InputError
        If the displacement does not fit the mesh, is not finite, or throws the
        body over an absurd number of voxels.
    """
    raster = _rasterise(mesh, displacement_mm, reference if lattice is None else lattice)
    values = np.ascontiguousarray(reference.values)
    out = np.full(raster.shape, Tissue.AIR, dtype=values.dtype)
    sources = _index_coordinates(mesh.nodes, reference)
    _write_nearest(
        raster.fixed, raster.bits, raster.nodes, sources, raster.tets, raster.runs, values, out
    )
    return raster.volume(out)


def warp_grey(
    reference: Volume,
    mesh: TetMesh,
    displacement_mm: FloatArray,
    lattice: Volume | None = None,
    *,
    outside: float = 0.0,
) -> Volume:
    """Deform a grey volume; a voxel takes the trilinear value between reference voxels.

    Within half a voxel of the border of `reference` its outermost value holds.

    Parameters
    ----------
    reference, mesh, displacement_mm, lattice
        As for `warp_labels`; the values may be of any real type.
    outside : float
        Value outside the elements and of voxels from outside `reference`.

    Returns
    -------
    Volume of float32

    Raises
    ------
    InputError
        As `warp_labels`.
    """
    raster = _rasterise(mesh, displacement_mm, reference if lattice is None else lattice)
    values = np.ascontiguousarray(reference.values)
    out = np.full(raster.shape, outside, dtype=np.float32)
    sources = _index_coordinates(mesh.nodes, reference)
    _write_trilinear(
        raster.fixed, raster.bits, raster.nodes, sources, raster.tets, raster.runs, values, out
    )
    return raster.volume(out)


def warp_coverage(mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume) -> Coverage:
    """Count how many elements own each voxel of the deformed body.

    Parameters
    ----------
    mesh, displacement_mm, lattice
        As for `warp_labels`.

    Returns
    -------
    Coverage

    Raises
    ------
    InputError
        As `warp_labels`.
    """
    raster = _rasterise(mesh, displacement_mm, lattice)
    counts = np.zeros(raster.shape, dtype=np.uint8)
    inverted = _count_writes(raster.fixed, raster.bits, raster.tets, raster.runs, counts)
    return Coverage(raster.volume(counts), int(inverted))


def _index_coordinates(points_mm: FloatArray, lattice: Volume) -> FloatArray:
    """Positions in voxels of `lattice`, whole numbers at voxel centres."""
    return (np.asarray(points_mm, dtype=np.float64) - lattice.origin_mm) / lattice.spacing_mm


def _rasterise(mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume) -> _Raster:
    displacement = np.asarray(displacement_mm, dtype=np.float64)
    if displacement.shape != mesh.nodes.shape:
        raise InputError(
            f"The displacement has shape {displacement.shape}, the mesh has nodes "
            f"{mesh.nodes.shape}. Use the displacement of this mesh."
        )
    if not np.isfinite(displacement).all():
        raise InputError(
            "The displacement has values that are not finite. Deform only with the result of a "
            "simulation that converged."
        )
    if mesh.tets.size == 0:
        raise InputError("The mesh has no elements, so there is nothing to deform.")
    tets = np.ascontiguousarray(mesh.tets, dtype=np.int32)
    deformed = _index_coordinates(mesh.nodes + displacement, lattice)
    used = np.unique(tets)
    base = np.floor(deformed[used].min(axis=0))
    extent = deformed[used].max(axis=0) - base
    if float(np.prod(extent + 1.0)) > MAX_VOXELS:
        raise InputError(
            f"The deformed body would fill a box of {extent[0]:.4g} x {extent[1]:.4g} x "
            f"{extent[2]:.4g} voxels. Check that the displacement is in mm and that the "
            "simulation converged, or use larger voxels."
        )
    fixed, bits = fixed_point(deformed - base, tets)
    # The box follows from the snapped corners, so that no run can leave it. A body
    # thinner than a voxel may hold no centre: the box keeps one voxel all the same.
    first = -(-fixed[used].min(axis=0) >> bits)
    end = np.maximum(-(-fixed[used].max(axis=0) >> bits), first + 1)
    fixed -= first << bits
    start = base + first
    ox, oy, oz = (np.asarray(lattice.origin_mm) + start * lattice.spacing_mm).tolist()
    nx, ny, nz = (end - first).tolist()
    return _Raster(
        fixed=fixed,
        bits=bits,
        nodes=deformed - start,
        tets=tets,
        runs=run_buffer(fixed, tets, bits),
        shape=(nz, ny, nx),
        spacing_mm=lattice.spacing_mm,
        origin_mm=(ox, oy, oz),
    )


@njit(cache=True, nogil=True)
def _pull_back(fixed, bits, nodes, sources, tets, t, six_volumes, m):  # type: ignore[no-untyped-def]
    """Fill m (3, 4) with the affine map from voxels of the output to voxels of the reference."""
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
        # An element nearly as flat as the grid step: only its snapped shape is sure to be upright.
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


@njit(cache=True, nogil=True)
def _within(sources, tets, t, shape):  # type: ignore[no-untyped-def]
    """Whether all of an element comes from inside the reference box: no checks per voxel."""
    for corner in range(4):
        for axis in range(3):
            x = sources[tets[t, corner], axis]
            if x < -0.499 or x > shape[2 - axis] - 0.501:
                return False
    return True


@njit(cache=True, nogil=True)
def _write_nearest(fixed, bits, nodes, sources, tets, runs, values, out):  # type: ignore[no-untyped-def]
    nz, ny, nx = values.shape
    flat = values.reshape(-1)
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        six_volumes = signed_volume(fixed, tets, t)
        if six_volumes <= 0:
            continue
        count = tet_runs(fixed, tets, t, bits, runs)
        if count == 0:
            continue
        _pull_back(fixed, bits, nodes, sources, tets, t, six_volumes, m)
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


@njit(cache=True, nogil=True)
def _cell(s, n):  # type: ignore[no-untyped-def]
    """Lower and upper voxel around s and the weight of the upper, held at the border."""
    s = min(max(s, 0.0), n - 1.0)
    low = np.int64(s)
    return low, min(low + 1, n - 1), s - low


@njit(cache=True, nogil=True)
def _trilinear(values, sx, sy, sz):  # type: ignore[no-untyped-def]
    nz, ny, nx = values.shape
    x0, x1, fx = _cell(sx, nx)
    y0, y1, fy = _cell(sy, ny)
    z0, z1, fz = _cell(sz, nz)
    a = values[z0, y0, x0] * (1 - fx) + values[z0, y0, x1] * fx
    b = values[z0, y1, x0] * (1 - fx) + values[z0, y1, x1] * fx
    c = values[z1, y0, x0] * (1 - fx) + values[z1, y0, x1] * fx
    d = values[z1, y1, x0] * (1 - fx) + values[z1, y1, x1] * fx
    return (a * (1 - fy) + b * fy) * (1 - fz) + (c * (1 - fy) + d * fy) * fz


@njit(cache=True, nogil=True)
def _write_trilinear(fixed, bits, nodes, sources, tets, runs, values, out):  # type: ignore[no-untyped-def]
    nz, ny, nx = values.shape
    m = np.empty((3, 4))
    for t in range(tets.shape[0]):
        six_volumes = signed_volume(fixed, tets, t)
        if six_volumes <= 0:
            continue
        count = tet_runs(fixed, tets, t, bits, runs)
        if count == 0:
            continue
        _pull_back(fixed, bits, nodes, sources, tets, t, six_volumes, m)
        for r in range(count):
            z, y = runs[r, 0], runs[r, 1]
            line = out[z, y]
            for x in range(runs[r, 2], runs[r, 3]):
                sx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
                sy = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
                sz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                if -0.5 <= sx < nx - 0.5 and -0.5 <= sy < ny - 0.5 and -0.5 <= sz < nz - 0.5:
                    line[x] = _trilinear(values, sx, sy, sz)


@njit(cache=True, nogil=True)
def _count_writes(fixed, bits, tets, runs, counts):  # type: ignore[no-untyped-def]
    inverted = 0
    for t in range(tets.shape[0]):
        if signed_volume(fixed, tets, t) <= 0:
            inverted += 1
            continue
        count = tet_runs(fixed, tets, t, bits, runs)
        for r in range(count):
            for x in range(runs[r, 2], runs[r, 3]):
                counts[runs[r, 0], runs[r, 1], x] += 1
    return inverted
