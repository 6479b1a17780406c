"""Squared distances between voxels as whole numbers.

Whole numbers add without rounding, so every method of finding a nearest voxel gives the same
squared distance, bit for bit, and can be chosen for speed alone.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import Triple

# Small whole weights represent a spacing ratio such as 0.2 : 0.5 exactly.
MAX_SMALL_UNIT = 1000
SMALL_UNIT_TOLERANCE = 1e-10
# Any other is rounded to 2**-24 of the finest; images of up to 2**13 voxels fit in 62 bits.
FINE_BITS = 24
SIZE_BITS = 13


@dataclass(frozen=True)
class Metric:
    """The squared distance ``wz dz**2 + wy dy**2 + wx dx**2`` of two voxels.

    Parameters
    ----------
    weights : tuple of int
        (wz, wy, wx); the smallest is the square of the finest spacing.
    unit_mm : float
        Millimetres per unit of distance, the root of a squared distance of 1.
    """

    weights: tuple[int, int, int]
    unit_mm: float

    @classmethod
    def of_spacing(cls, spacing_mm: Triple) -> "Metric":
        """Return the metric for a spacing (x, y, z), accurate to 1e-7 or better.

        Isotropic voxels and small ratios of squared spacings are exact.
        """
        finest = min(spacing_mm)
        squares = np.array([(s / finest) ** 2 for s in reversed(spacing_mm)])
        for unit in range(1, MAX_SMALL_UNIT + 1):
            scaled = squares * unit
            if np.all(np.abs(scaled - np.rint(scaled)) <= SMALL_UNIT_TOLERANCE * scaled):
                break
        else:
            room = 62 - 4 - 2 * SIZE_BITS - int(np.ceil(np.log2(squares.max())))
            unit = 2 ** max(0, min(FINE_BITS, room))
        wz, wy, wx = (int(w) for w in np.rint(squares * unit))
        return cls((wz, wy, wx), float(finest / np.sqrt(unit)))

    def ball(self, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """List offsets to all voxels within `radius` times the finest spacing, nearest first.

        Returns
        -------
        ndarray of int64, shape (k, 3)
            Offsets (dz, dy, dx), without (0, 0, 0).
        ndarray of int64, shape (k,)
            Squared lengths of the offsets, ascending.
        """
        return _nearest_first(self.weights, radius**2 * min(self.weights))

    def disc(self, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """List offsets (dz, dy) to lines along x within `radius`, nearest first, with (0, 0)."""
        offsets, squares = _nearest_first(self.weights[:2], radius**2 * min(self.weights))
        zero = np.zeros((1, 2), dtype=np.int64)
        return np.concatenate([zero, offsets]), np.concatenate([zero[0, :1], squares])


@lru_cache(maxsize=8)
def _nearest_first(
    weights: tuple[int, ...], limit: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List all nonzero offsets with a squared length up to a limit, and their squared lengths."""
    reach = [np.arange(-k, k + 1) for k in (math.isqrt(limit // w) for w in weights)]
    offsets = np.stack(np.meshgrid(*reach, indexing="ij"), axis=-1).reshape(-1, len(weights))
    squares = offsets.astype(np.int64) ** 2 @ np.array(weights, dtype=np.int64)
    order = np.argsort(squares, kind="stable")
    order = order[(squares[order] <= limit) & (squares[order] > 0)]
    arrays = offsets[order].astype(np.int64), squares[order]
    for array in arrays:
        array.setflags(write=False)  # cached and shared
    return arrays
