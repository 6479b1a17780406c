"""Node numbering that keeps spatial neighbours close in memory."""

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import TetMesh


def in_memory_order(mesh: TetMesh, step_mm: float) -> TetMesh:
    """Reorder a mesh so that spatial neighbours are close in memory.

    Nodes follow a Morton curve of cubes of ``step_mm``, tetrahedra follow their smallest node.
    """
    cell = ((mesh.nodes - mesh.nodes.min(axis=0)) / step_mm).astype(np.uint64)
    code = np.zeros(len(cell), np.uint64)
    for axis in range(3):
        code |= _spread_bits(cell[:, axis]) << np.uint64(axis)
    order = np.argsort(code, kind="stable").astype(np.int32)
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    tets = number[mesh.tets]
    tets = tets[np.argsort(tets.min(axis=1), kind="stable")]
    return TetMesh(mesh.nodes[order], np.ascontiguousarray(tets))


def _spread_bits(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the lowest 21 bits."""
    value = value & np.uint64(0x1FFFFF)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
