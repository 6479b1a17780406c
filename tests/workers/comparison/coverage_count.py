"""Number of elements in a deformed mesh that own each voxel, counted run by run."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray, TetMesh, Volume
from palpate.workers.comparison.rasterisation import place_on_lattice, signed_volume, tet_runs


@dataclass(frozen=True, eq=False)
class Coverage:
    """Number of owners of each voxel, and number of inverted elements, which own no voxel."""

    counts: Volume
    inverted: int


def warp_coverage(mesh: TetMesh, displacement_mm: FloatArray, lattice: Volume) -> Coverage:
    """Return the number of owners of each voxel in the deformed body; 1 in a mesh without folds."""
    deformed = place_on_lattice(mesh, displacement_mm, lattice)
    counts = np.zeros(deformed.shape, dtype=np.uint8)
    inverted = 0
    for t in range(len(deformed.tets)):
        if signed_volume(deformed.fixed, deformed.tets, t) <= 0:
            inverted += 1
            continue
        count = tet_runs(deformed.fixed, deformed.tets, t, deformed.bits, deformed.runs)
        for z, y, first, end in deformed.runs[:count]:
            counts[z, y, first:end] += 1
    return Coverage(deformed.volume(counts, lattice), inverted)
