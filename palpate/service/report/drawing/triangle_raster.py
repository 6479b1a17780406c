"""Visible triangles of a surface at every pixel of a picture."""

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray

NONE = -1


def front_triangles(
    corners: FloatArray, nearness: FloatArray, rows: int, columns: int
) -> NDArray[np.int64]:
    """Return the index of the nearest triangle at the centre of each pixel.

    Every row of pixels is intersected with the sides of the triangles that it meets, so only pixels
    inside triangles are visited.

    Parameters
    ----------
    corners : ndarray, shape (m, 3, 2)
        Corners across and up, in pixels from the lower left corner of the picture.
    nearness : ndarray, shape (m,)
        At each pixel, the triangle with the largest value is visible.
    rows, columns : int
        Size of the picture.

    Returns
    -------
    ndarray of int, shape (rows, columns)
        Row 0 at the bottom; `NONE` without a triangle.
    """
    order = np.argsort(nearness, kind="stable")
    x, y = corners[order].transpose(2, 0, 1)
    first, last = _middles(y.min(axis=1), y.max(axis=1), rows)
    triangle, row = _ranges(first, last)
    low, high = _cut(x[triangle], y[triangle], np.asarray(row + 0.5, np.float64))
    left, right = _middles(low, high, columns)
    line, column = _ranges(left, right)
    seen = np.full(rows * columns, NONE)
    np.maximum.at(seen, row[line] * columns + column, triangle[line])
    return np.append(order, NONE)[seen].reshape(rows, columns)


def _middles(
    low: FloatArray, high: FloatArray, size: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and last of `size` pixels with centres between two positions."""
    first, last = np.ceil(low - 0.5), np.floor(high - 0.5)
    return np.clip(first, 0, size).astype(np.int64), np.clip(last, -1, size - 1).astype(np.int64)


def _ranges(
    first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all integers of ranges `first` to `last`, and the range of each."""
    counts = np.maximum(last - first + 1, 0)
    which = np.repeat(np.arange(len(counts)), counts)
    ends = np.cumsum(counts)
    return which, np.arange(len(which)) + (first - ends + counts)[which]


def _cut(x: FloatArray, y: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the entry and exit points of lines along x at `at` in the triangles they meet."""
    low, high = np.full(len(at), np.inf), np.full(len(at), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        rise = y[:, b] - y[:, a]
        met = (at - y[:, a]) * (at - y[:, b]) <= 0
        share = (at - y[:, a]) / np.where(rise == 0, 1.0, rise)
        place = x[:, a] + share * (x[:, b] - x[:, a])
        met &= rise != 0
        low = np.where(met, np.minimum(low, place), low)
        high = np.where(met, np.maximum(high, place), high)
    return low, high
