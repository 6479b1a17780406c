"""Arclength on polylines."""

import numpy as np

from palpate.storage.values import FloatArray


def arclength_mm(points_mm: FloatArray) -> FloatArray:
    """Return the arclengths from the first point of a polyline to each of its points.

    Parameters
    ----------
    points_mm : ndarray, shape (n, 2)

    Returns
    -------
    ndarray, shape (n,)
        Starts with zero; not descending.
    """
    steps = np.diff(points_mm, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])


def points_at(points_mm: FloatArray, at_mm: FloatArray) -> FloatArray:
    """Return the points of a polyline at given arclengths.

    Parameters
    ----------
    points_mm : ndarray, shape (n, 2)
    at_mm : ndarray, shape (k,)
        Arclengths from the first point, clipped to the polyline.

    Returns
    -------
    ndarray, shape (k, 2)
    """
    along = arclength_mm(points_mm)
    return np.column_stack(
        [np.interp(at_mm, along, points_mm[:, 0]), np.interp(at_mm, along, points_mm[:, 1])]
    )
