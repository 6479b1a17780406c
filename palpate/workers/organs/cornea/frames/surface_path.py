"""The left-to-right path through an image with the largest gain."""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray


def best_path(gain: FloatArray, steepest: int, bend: float) -> IntArray:
    """Return the row in each column of the path with the largest sum of gains.

    The solution by dynamic programming is exact.

    Parameters
    ----------
    gain : ndarray, shape (rows, columns)
        ``-inf`` where the path is not allowed.
    steepest : int
        Largest difference of rows between neighbouring columns; >= 1.
    bend : float
        Penalty per row of difference.

    Returns
    -------
    ndarray of int32, shape (columns,)
    """
    path: IntArray = _best_path(np.ascontiguousarray(gain), steepest, bend)
    return path


@njit(cache=True, nogil=True)
def _best_path(gain: FloatArray, steepest: int, bend: float) -> IntArray:
    """Return the row of the path in every column; see `best_path`."""
    rows, columns = gain.shape
    total = gain[:, 0].copy()
    previous = np.zeros((rows, columns), dtype=np.int32)
    for c in range(1, columns):
        following = np.empty(rows)
        for r in range(rows):
            best = -np.inf
            where = r
            for s in range(max(0, r - steepest), min(rows, r + steepest + 1)):
                value = total[s] - bend * abs(s - r)
                if value > best:
                    best = value
                    where = s
            following[r] = best + gain[r, c]
            previous[r, c] = where
        total = following
    path = np.empty(columns, dtype=np.int32)
    path[columns - 1] = np.argmax(total)
    for c in range(columns - 1, 0, -1):
        path[c - 1] = previous[path[c], c]
    return path
