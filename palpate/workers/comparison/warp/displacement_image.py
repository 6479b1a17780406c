"""Displacement of the tissue at each voxel of a deformed image."""

import numpy as np

from palpate.storage.values import FloatArray, TetMesh, Volume
from palpate.workers.comparison.warp.warp_volume import warp_grey


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
