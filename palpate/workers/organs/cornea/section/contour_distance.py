"""Mean distance from one closed contour to another."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray

# Number of sides that share a bounding box in the search for the nearest one.
CHUNK = 16


@dataclass(frozen=True, eq=False)
class ContourSamples:
    """Points along a contour with their weights.

    Parameters
    ----------
    points : ndarray, shape (k, 2)
        Midpoints of equal pieces of the sides.
    weights : ndarray, shape (k,)
        Length of the piece, or its number of boundary pixels; > 0.
    """

    points: FloatArray
    weights: FloatArray


def contour_samples(polygon: FloatArray, spacing: float, pixelwise: bool) -> ContourSamples:
    """Return points along a closed contour, at most a given spacing apart.

    Parameters
    ----------
    polygon : ndarray, shape (n, 2)
    spacing : float
        Same unit as the points; > 0.
    pixelwise : bool
        Weight a piece by the larger of its extents along x and y, which is its number of
        pixels in a thin (8-connected) digital boundary, instead of by its length.

    Returns
    -------
    ContourSamples
    """
    step = np.roll(polygon, -1, axis=0) - polygon
    length = np.hypot(step[:, 0], step[:, 1])
    weight = np.abs(step).max(axis=1) if pixelwise else length
    pieces = np.ceil(length / spacing).astype(np.int64)
    side = np.repeat(np.arange(len(polygon)), pieces)
    number = np.arange(len(side)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    part = (number + 0.5) / pieces[side]
    return ContourSamples(
        points=polygon[side] + part[:, None] * step[side], weights=weight[side] / pieces[side]
    )


def mean_distance(samples: ContourSamples, polygon: FloatArray) -> float:
    """Return the weighted mean of the exact distances of points from a closed contour.

    Parameters
    ----------
    samples : ContourSamples
    polygon : ndarray, shape (n, 2)

    Returns
    -------
    float
    """
    closed = np.concatenate([polygon, polygon[:1]])
    return float(np.average(distances(samples.points, closed), weights=samples.weights))


def distances(points: FloatArray, polyline: FloatArray) -> FloatArray:
    """Return the exact distances of points from an open polyline.

    Parameters
    ----------
    points : ndarray, shape (k, 2)
    polyline : ndarray, shape (n, 2)
        At least two points.

    Returns
    -------
    ndarray, shape (k,)
    """
    xs, ys = np.ascontiguousarray(polyline.T)
    return np.sqrt(_squared_distances(np.ascontiguousarray(points), xs, ys))


@njit(cache=True, nogil=True)
def _squared_distances(points: FloatArray, xs: FloatArray, ys: FloatArray) -> FloatArray:
    """Return the squared distances of points from a polyline, chunk by chunk."""
    sides = len(xs) - 1
    chunks = (sides + CHUNK - 1) // CHUNK
    box = np.empty((chunks, 4))
    for c in range(chunks):
        first = c * CHUNK
        last = min(sides, first + CHUNK) + 1
        box[c, 0] = xs[first:last].min()
        box[c, 1] = ys[first:last].min()
        box[c, 2] = xs[first:last].max()
        box[c, 3] = ys[first:last].max()
    out = np.empty(len(points))
    nearest = 0
    for k in range(len(points)):
        px = points[k, 0]
        py = points[k, 1]
        # The nearest chunk of the previous point gives a small initial bound.
        best = _to_chunk(px, py, xs, ys, nearest, np.inf)
        for c in range(chunks):
            gx = max(box[c, 0] - px, 0.0, px - box[c, 2])
            gy = max(box[c, 1] - py, 0.0, py - box[c, 3])
            if gx * gx + gy * gy < best:
                closer = _to_chunk(px, py, xs, ys, c, best)
                if closer < best:
                    best = closer
                    nearest = c
        out[k] = best
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _to_chunk(
    px: float, py: float, xs: FloatArray, ys: FloatArray, chunk: int, best: float
) -> float:
    """Return the smallest squared distance from the sides of a chunk, or `best` if smaller."""
    for i in range(chunk * CHUNK, min(len(xs) - 1, (chunk + 1) * CHUNK)):
        ax = xs[i] - px
        ay = ys[i] - py
        ex = xs[i + 1] - xs[i]
        ey = ys[i + 1] - ys[i]
        length = ex * ex + ey * ey
        along = -(ax * ex + ay * ey)
        if along > 0.0 and length > 0.0:
            t = along / length if along < length else 1.0
            ax += t * ex
            ay += t * ey
        best = min(best, ax * ax + ay * ay)
    return best
