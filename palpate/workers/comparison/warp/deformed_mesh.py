"""Deformed meshes on the voxel lattice of an output image."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, TetMesh, Triple, Volume
from palpate.workers.comparison.warp.rasterisation import fixed_point, run_buffer

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
        Buffer for the runs of one tetrahedron; see `workers.comparison.warp.rasterisation`.
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
