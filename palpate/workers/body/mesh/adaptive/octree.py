"""Octrees of cubic cells: fine where required; neighbours differ by a factor of two at most."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray

Levels = NDArray[np.uint8]


def graded_levels(largest: Levels, layers: int = 1) -> Levels:
    """Return the level of the leaf that contains each of the smallest cells.

    A leaf of level l is an aligned cube of 2^l smallest cells along each edge. Leaves
    that share a face, an edge or a corner differ by one level at most.

    Parameters
    ----------
    largest : ndarray of uint8, shape (nz, ny, nx)
        Largest level allowed at each smallest cell; every side is a multiple of two to
        the power of the largest of them.
    layers : int
        Least number of leaves of a level between finer and coarser ones, >= 1.

    Returns
    -------
    ndarray of uint8, shape (nz, ny, nx)

    Raises
    ------
    InputError
        If the sides do not fit the levels.
    """
    top = int(largest.max(initial=0))
    if any(side % 2**top for side in largest.shape):
        raise InputError(
            f"Cells of level {top} need sides that are multiples of {2**top}, got {largest.shape}."
        )
    levels = np.zeros(largest.shape, np.uint8)
    allowed = largest
    covered: BoolArray = np.ones(largest.shape, np.bool_)  # by leaves of this level or above
    for level in range(1, top + 1):
        allowed = _of_eight(allowed, np.minimum)
        complete = _of_eight(covered, np.logical_and)
        around = minimum_filter(complete, size=2 * layers + 1, mode="constant", cval=1)
        covered = (allowed >= level) & around
        size = 2**level
        leaf = covered.repeat(size, 0).repeat(size, 1).repeat(size, 2)
        levels[leaf] = level
    return levels


def _of_eight(values: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """Combine the values of the eight children of each cell of the next level."""
    for axis in range(3):
        even = tuple(slice(0, None, 2) if a == axis else slice(None) for a in range(3))
        odd = tuple(slice(1, None, 2) if a == axis else slice(None) for a in range(3))
        values = combine(values[even], values[odd])
    return values
