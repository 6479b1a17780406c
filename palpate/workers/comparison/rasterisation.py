"""Deformed meshes on a voxel lattice: the voxels of each tetrahedron, determined in whole numbers.

Two neighbours must agree on every voxel of the face that they share, or the deformed image gets
holes and double writes. Rounding cannot break that agreement here because nothing is rounded
after the first step:

1. Node positions are snapped once to a grid of ``2**bits`` steps per voxel
   (finer than a thousandth of a voxel for any sensible element), so both
   neighbours use the same corners.
2. A line of voxels along x intersects a tetrahedron between two of
   its faces. The faces that the line pierces follow from the signs of the six
   edge functions in the (y, z) plane, exact in 64-bit integers. A line through
   an edge or a corner is moved by (eps, eps**2) in (y, z), symbolically [1]_, so
   that it always pierces none or two faces.
3. The intersection of the line with a face is a ratio of integers; its ceiling is exact,
   hence the same for both neighbours. A run is half open,
   ``[ceil(x_in), ceil(x_out))``.

Along one line the runs of an unfolded mesh therefore join end to start: each voxel centre inside
belongs to exactly one tetrahedron.

References
----------
.. [1] H. Edelsbrunner, E. P. Muecke, Simulation of Simplicity, ACM Trans.
   Graph. 9(1), 1990.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Triple, Volume
from palpate.workers.kernels_and_threads import EXACT, EXACT_UNCHECKED

MAX_BITS = 16
# Extents below 2**19 steps keep products of three of them within 64 bits.
EXTENT_BITS = 18
MIN_BITS = 4


def _pierced_faces() -> NDArray[np.uint8]:
    """Tabulate the pierced faces by the signs of edges 01, 02, 03, 12, 13, 23 (bits 0 to 5).

    Bits 0 to 3 of an entry represent faces 012, 013, 023, 123. Face abc is
    pierced if e_ab, e_bc and e_ca = -e_ac agree in sign. Impossible signs get no face.
    """
    table = np.zeros(64, dtype=np.uint8)
    for signs in range(64):
        s01, s02, s03, s12, s13, s23 = (bool(signs >> edge & 1) for edge in range(6))
        faces = ((s01, s12, s02), (s01, s13, s03), (s02, s23, s03), (s12, s23, s13))
        hits = [ab == bc != ac for ab, bc, ac in faces]
        if sum(hits) == 2:
            table[signs] = sum(1 << face for face, hit in enumerate(hits) if hit)
    return table


_PIERCED = _pierced_faces()


def fixed_point(
    nodes_index: NDArray[np.float64], tets: NDArray[np.int32]
) -> tuple[NDArray[np.int64], int]:
    """Snap node positions to a fine integer grid.

    Parameters
    ----------
    nodes_index : ndarray, shape (n, 3)
        Positions (x, y, z) in voxels.
    tets : ndarray of int32, shape (m, 4)

    Returns
    -------
    ndarray of int64, shape (n, 3)
        Positions in steps of ``2**-bits`` voxels.
    int
        ``bits``.

    Raises
    ------
    InputError
        If an element spans so many voxels that the grid would be too coarse.
    """
    extent = float(_largest_extent(nodes_index, tets))
    bits = min(MAX_BITS, EXTENT_BITS - int(np.ceil(np.log2(max(extent, 1.0)))))
    if bits < MIN_BITS:
        raise InputError(
            f"An element spans {extent:.0f} voxels after deformation, more than "
            f"{2 ** (EXTENT_BITS - MIN_BITS)}. Check that the displacement is in mm and that "
            "the simulation converged, or use larger voxels."
        )
    return np.rint(nodes_index * float(2**bits)).astype(np.int64), bits


def run_buffer(
    nodes_fixed: NDArray[np.int64], tets: NDArray[np.int32], bits: int
) -> NDArray[np.int32]:
    """Allocate a buffer for the runs (z, y, first x, end x) of the largest tetrahedron."""
    return np.empty((max(1, int(_most_lines(nodes_fixed, tets, bits))), 4), dtype=np.int32)


@njit(**EXACT)
def _largest_extent(nodes: FloatArray, tets: IntArray) -> float:
    largest = 0.0
    for t in range(tets.shape[0]):
        for axis in range(3):
            low = high = nodes[tets[t, 0], axis]
            for corner in range(1, 4):
                value = nodes[tets[t, corner], axis]
                low = min(low, value)
                high = max(high, value)
            largest = max(largest, high - low)
    return largest


@njit(**EXACT)
def _most_lines(nodes: NDArray[np.int64], tets: IntArray, bits: int) -> int:
    most = 0
    for t in range(tets.shape[0]):
        lines = 1
        for axis in range(1, 3):
            low = high = nodes[tets[t, 0], axis]
            for corner in range(1, 4):
                value = nodes[tets[t, corner], axis]
                low = min(low, value)
                high = max(high, value)
            lines *= (high >> bits) - (low >> bits) + 1
        most = max(most, lines)
    return most


@njit(**EXACT)
def _local(
    nodes: NDArray[np.int64], v: int, ox: int, oy: int, oz: int, bits: int
) -> tuple[int, int, int]:
    return nodes[v, 0] - (ox << bits), nodes[v, 1] - (oy << bits), nodes[v, 2] - (oz << bits)


@njit(**EXACT)
def _edge(ya: int, za: int, yb: int, zb: int) -> tuple[int, int, int]:
    """Return slopes of cross(b - a, p - a) in p = (y, z), and the bias that breaks ties.

    With the bias, ``e + bias >= 0`` is the sign of e at (y + eps, z + eps**2);
    swapping a and b swaps it.
    """
    along_y = za - zb
    along_z = yb - ya
    positive = along_y > 0 or (along_y == 0 and along_z > 0)
    return along_y, along_z, 0 if positive else -1


@njit(**EXACT_UNCHECKED)
def _ceil_on_face(e_bc: int, e_ca: int, e_ab: int, xa: int, xb: int, xc: int, bits: int) -> int:
    """Return the first voxel at or beyond the intersection with the face (all x >= 0)."""
    area = (e_bc + e_ca + e_ab) << bits
    moment = e_bc * xa + e_ca * xb + e_ab * xc
    if area < 0:
        area = -area
        moment = -moment
    return (moment + area - 1) // area


@njit(**EXACT_UNCHECKED)
def signed_volume(nodes: NDArray[np.int64], tets: IntArray, t: int) -> int:
    """Return six times the volume of a tetrahedron in cubed steps, exact."""
    a, b, c, d = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
    x1 = nodes[b, 0] - nodes[a, 0]
    y1 = nodes[b, 1] - nodes[a, 1]
    z1 = nodes[b, 2] - nodes[a, 2]
    x2 = nodes[c, 0] - nodes[a, 0]
    y2 = nodes[c, 1] - nodes[a, 1]
    z2 = nodes[c, 2] - nodes[a, 2]
    x3 = nodes[d, 0] - nodes[a, 0]
    y3 = nodes[d, 1] - nodes[a, 1]
    z3 = nodes[d, 2] - nodes[a, 2]
    return x1 * (y2 * z3 - z2 * y3) - y1 * (x2 * z3 - z2 * x3) + z1 * (x2 * y3 - y2 * x3)


@njit(**EXACT_UNCHECKED)
def tet_runs(nodes: NDArray[np.int64], tets: IntArray, t: int, bits: int, runs: IntArray) -> int:
    """List the runs of voxels of one tetrahedron.

    Parameters
    ----------
    nodes : ndarray of int64, shape (n, 3)
        Positions in steps of ``2**-bits`` voxels.
    tets : ndarray of int32, shape (m, 4)
    t : int
        Index of the tetrahedron.
    bits : int
    runs : ndarray of int32, shape (k, 4)
        Filled with rows (z, y, first x, end x), z slowest.

    Returns
    -------
    int
        Number of rows filled.
    """
    v0, v1, v2, v3 = tets[t, 0], tets[t, 1], tets[t, 2], tets[t, 3]
    # A local origin at a voxel keeps the numbers small at any position of the element.
    ox = min(min(nodes[v0, 0], nodes[v1, 0]), min(nodes[v2, 0], nodes[v3, 0])) >> bits
    oy = min(min(nodes[v0, 1], nodes[v1, 1]), min(nodes[v2, 1], nodes[v3, 1])) >> bits
    oz = min(min(nodes[v0, 2], nodes[v1, 2]), min(nodes[v2, 2], nodes[v3, 2])) >> bits
    x0, y0, z0 = _local(nodes, v0, ox, oy, oz, bits)
    x1, y1, z1 = _local(nodes, v1, ox, oy, oz, bits)
    x2, y2, z2 = _local(nodes, v2, ox, oy, oz, bits)
    x3, y3, z3 = _local(nodes, v3, ox, oy, oz, bits)
    last_y = max(max(y0, y1), max(y2, y3)) >> bits
    last_z = max(max(z0, z1), max(z2, z3)) >> bits

    ay, az, a = _edge(y0, z0, y1, z1)  # edge 01, and so on: 02, 03, 12, 13, 23
    by, bz, b = _edge(y0, z0, y2, z2)
    cy, cz, c = _edge(y0, z0, y3, z3)
    dy, dz, d = _edge(y1, z1, y2, z2)
    ey, ez, e = _edge(y1, z1, y3, z3)
    fy, fz, f = _edge(y2, z2, y3, z3)

    count = 0
    for iz in range(last_z + 1):
        z = iz << bits
        e01 = az * (z - z0) - ay * y0
        e02 = bz * (z - z0) - by * y0
        e03 = cz * (z - z0) - cy * y0
        e12 = dz * (z - z1) - dy * y1
        e13 = ez * (z - z1) - ey * y1
        e23 = fz * (z - z2) - fy * y2
        entered = False
        for iy in range(last_y + 1):
            signs = (
                np.int64(e01 + a >= 0)
                | np.int64(e02 + b >= 0) << 1
                | np.int64(e03 + c >= 0) << 2
                | np.int64(e12 + d >= 0) << 3
                | np.int64(e13 + e >= 0) << 4
                | np.int64(e23 + f >= 0) << 5
            )
            pierced = _PIERCED[signs]
            if pierced:
                entered = True
                low = np.int64(-1)
                high = np.int64(-1)
                if pierced & 1:
                    high = _ceil_on_face(e12, -e02, e01, x0, x1, x2, bits)
                if pierced & 2:
                    low, high = high, _ceil_on_face(e13, -e03, e01, x0, x1, x3, bits)
                if pierced & 4:
                    low, high = high, _ceil_on_face(e23, -e03, e02, x0, x2, x3, bits)
                if pierced & 8:
                    low, high = high, _ceil_on_face(e23, -e13, e12, x1, x2, x3, bits)
                if low > high:
                    low, high = high, low
                if high > low:
                    runs[count, 0] = oz + iz
                    runs[count, 1] = oy + iy
                    runs[count, 2] = ox + low
                    runs[count, 3] = ox + high
                    count += 1
            elif entered:  # a tetrahedron is convex: the rest of this plane is outside
                break
            e01 += ay << bits
            e02 += by << bits
            e03 += cy << bits
            e12 += dy << bits
            e13 += ey << bits
            e23 += fy << bits
    return count


MAX_VOXELS = 2**32


@dataclass(frozen=True, eq=False)
class DeformedMesh:
    """A deformed mesh in the coordinates of its voxel bounding box.

    Parameters
    ----------
    fixed : ndarray of int64, shape (n, 3)
        Positions (x, y, z) relative to the first voxel of the box, in steps of ``2**-bits`` voxels.
    bits : int
    nodes : ndarray, shape (n, 3)
        The same positions in voxels, not snapped.
    tets : ndarray of int32, shape (m, 4)
    runs : ndarray of int32, shape (k, 4)
        Buffer for the runs of one tetrahedron; see `workers.comparison.rasterisation`.
    shape : tuple of int
        Shape of the box, (nz, ny, nx).
    spacing_mm, origin_mm : tuple of float
        Lattice of the box, as in `storage.values.Volume`.
    """

    fixed: NDArray[np.int64]
    bits: int
    nodes: FloatArray
    tets: NDArray[np.int32]
    runs: NDArray[np.int32]
    shape: tuple[int, int, int]
    spacing_mm: Triple
    origin_mm: Triple

    def volume(self, values: NDArray[Any], undeformed: Volume) -> Volume:
        """Return values of shape (nz, ny, nx) as a volume, in the frame of the undeformed body."""
        spacing, origin = self.spacing_mm, self.origin_mm
        return replace(undeformed, values=values, spacing_mm=spacing, origin_mm=origin)


def index_coordinates(points_mm: FloatArray, lattice: Volume) -> FloatArray:
    """Return positions in voxels of `lattice`, whole numbers at voxel centres, shape (n, 3)."""
    return (np.asarray(points_mm, dtype=np.float64) - lattice.origin_mm) / lattice.spacing_mm


def place_on_lattice(mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume) -> DeformedMesh:
    """Deform a mesh and find its bounding box on a voxel lattice.

    Parameters
    ----------
    mesh : TetMesh
    displacement_mm : ndarray, shape (n, 3)
        Displacement (x, y, z) of every node.
    lattice : Volume
        Only its spacing and the phase of its voxel centres are used.

    Raises
    ------
    InputError
        If the displacement does not fit the mesh, is not finite, or spreads the body over an
        implausible number of voxels.
    """
    displacement = np.asarray(displacement_mm, dtype=np.float64)
    if displacement.shape != mesh.nodes.shape:
        raise InputError(
            f"The displacement has shape {displacement.shape}, but the mesh has nodes of shape "
            f"{mesh.nodes.shape}. Use a displacement of this mesh."
        )
    if not np.isfinite(displacement).all():
        raise InputError(
            "The displacement has values that are not finite. Use the result of a simulation that "
            "converged."
        )
    if mesh.tets.size == 0:
        raise InputError("The mesh has no elements to deform.")
    tets = np.ascontiguousarray(mesh.tets, dtype=np.int32)
    deformed = index_coordinates(mesh.nodes + displacement, lattice)
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
    # The box is computed from the snapped corners, so that no run can leave it. A body thinner than
    # a voxel may contain no voxel centre, so the box has at least one voxel.
    first = -(-fixed[used].min(axis=0) >> bits)
    end = np.maximum(-(-fixed[used].max(axis=0) >> bits), first + 1)
    fixed -= first << bits
    start = base + first
    ox, oy, oz = (np.asarray(lattice.origin_mm) + start * lattice.spacing_mm).tolist()
    nx, ny, nz = (end - first).tolist()
    return DeformedMesh(
        fixed=fixed,
        bits=bits,
        nodes=deformed - start,
        tets=tets,
        runs=run_buffer(fixed, tets, bits),
        shape=(nz, ny, nx),
        spacing_mm=lattice.spacing_mm,
        origin_mm=(ox, oy, oz),
    )
