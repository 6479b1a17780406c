"""Smallest number of nodes for a body, estimated before meshing."""

import math

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Volume

FEWEST_CELLS = 4  # across the body's shortest side, for the finest mesh
# Ratio of the nodes of a breast's coarsest possible mesh to those of a lattice inside it: measured
# 1.6 and 1.7 on phantoms of 445 and 250 ml. Below the first value a body is refused without
# meshing; the second one is always sufficient.
CERTAIN_SHARE, ENOUGH_SHARE = 1.4, 1.85


def check_node_count(nodes: int, volume_mm3: float, smallest_extent_mm: float) -> None:
    """Raise InputError, without meshing, if a mesh of so few nodes is too coarse for a body.

    Parameters
    ----------
    nodes : int
        Target number.
    volume_mm3, smallest_extent_mm : float
        Volume of the body, and its shortest side.

    Raises
    ------
    InputError
        If elements would be too large for the body.
    """
    largest_mm = smallest_extent_mm / FEWEST_CELLS
    lattice = 2 * volume_mm3 / largest_mm**3
    if nodes < CERTAIN_SHARE * lattice:
        enough = 50 * math.ceil(ENOUGH_SHARE * lattice / 50)
        raise InputError(
            f"A mesh of {nodes} nodes is too coarse for this body: its shortest side, "
            f"{smallest_extent_mm:.3g} mm, needs {FEWEST_CELLS} elements across. Ask for "
            f"{enough} nodes or more."
        )


def check_node_count_of(nodes: int, labels: Volume) -> None:
    """Raise InputError if a mesh of so few nodes is too coarse for a labelled body.

    Raises
    ------
    InputError
        See `check_node_count`.
    """
    inside = labels.values != 0
    count = np.count_nonzero(inside)
    if not count:
        return
    flat = inside.any(axis=0)
    lines = inside.any(axis=(1, 2)), flat.any(axis=1), flat.any(axis=0)
    sides = [
        (float(np.ptp(np.flatnonzero(line))) + 1) * step
        for line, step in zip(lines, labels.spacing_mm[::-1], strict=True)
    ]
    check_node_count(nodes, count * labels.voxel_mm3, min(sides))
