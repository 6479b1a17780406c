"""Exact areas of two polygons and of their intersection."""

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray

# Most sides of both polygons above one x; two sections need 4, folds more.
MAX_SIDES = 256


def overlap_areas(a: FloatArray, b: FloatArray) -> tuple[float, float, float]:
    """Return the areas of two polygons and of their intersection.

    The plane is cut into vertical strips between neighbouring vertices. Inside a strip the sides
    are straight lines; where sides cross, the strip is cut again. Every piece then consists of
    trapezoids, so the areas are exact except for rounding. The even-odd rule defines the
    interior, so polygons may have any shape.

    Parameters
    ----------
    a, b : ndarray, shape (n, 2) and (m, 2)
        Vertices in order, closed by the side from the last to the first.

    Returns
    -------
    area_a, area_b, area_of_both : float

    Raises
    ------
    ValueError
        If more than 256 sides are above one x.
    """
    sides = np.concatenate([_sides(a, 1), _sides(b, 2)])
    sides = sides[np.argsort(sides[:, 0], kind="stable")]
    xs = np.unique(np.concatenate([a[:, 0], b[:, 0]]))
    area_a, area_b, both = _sweep(sides, xs)
    if area_a < 0:
        raise ValueError(f"More than {MAX_SIDES} sides of the two polygons are above one x.")
    return area_a, area_b, both


def _sides(polygon: FloatArray, owner: int) -> FloatArray:
    """Return start x, start y, end x, end y and owner of the sides that are not vertical."""
    following = np.roll(polygon, -1, axis=0)
    swap = (following[:, 0] < polygon[:, 0])[:, None]
    left, right = np.where(swap, following, polygon), np.where(swap, polygon, following)
    rows = np.column_stack([left, right, np.full(len(polygon), float(owner))])
    return rows[right[:, 0] > left[:, 0]]


@njit(cache=True, nogil=True)
def _sweep(sides: FloatArray, xs: FloatArray) -> tuple[float, float, float]:
    """Return both areas and the intersection's; -1 three times if sides are too many."""
    active = np.empty(MAX_SIDES, dtype=np.int64)
    slope = np.empty(MAX_SIDES)
    level = np.empty(MAX_SIDES)
    height = np.empty(MAX_SIDES)
    cuts = np.empty(MAX_SIDES * MAX_SIDES)
    count = 0
    following = 0
    area_a = 0.0
    area_b = 0.0
    both = 0.0
    for strip in range(len(xs) - 1):
        x0 = xs[strip]
        x1 = xs[strip + 1]
        kept = 0
        for i in range(count):
            if sides[active[i], 2] > x0:
                active[kept] = active[i]
                kept += 1
        count = kept
        while following < len(sides) and sides[following, 0] <= x0:
            if count == MAX_SIDES:
                return -1.0, -1.0, -1.0
            active[count] = following
            following += 1
            count += 1
        for i in range(count):
            k = active[i]
            slope[i] = (sides[k, 3] - sides[k, 1]) / (sides[k, 2] - sides[k, 0])
            level[i] = sides[k, 1] + slope[i] * (x0 - sides[k, 0])
        pieces = 1
        cuts[0] = 0.0
        for i in range(count):
            for j in range(i):
                apart = level[i] - level[j]
                closing = slope[j] - slope[i]
                if apart * (apart - closing * (x1 - x0)) < 0:
                    cuts[pieces] = apart / closing
                    pieces += 1
        cuts[:pieces].sort()
        for k in range(pieces):
            end = cuts[k + 1] if k + 1 < pieces else x1 - x0
            width = end - cuts[k]
            middle = 0.5 * (end + cuts[k])
            for i in range(count):
                height[i] = level[i] + slope[i] * middle
            order = np.argsort(height[:count])
            inside_a = False
            inside_b = False
            for i in range(count - 1):
                if sides[active[order[i]], 4] == 1.0:
                    inside_a = not inside_a
                else:
                    inside_b = not inside_b
                area = width * (height[order[i + 1]] - height[order[i]])
                if inside_a:
                    area_a += area
                if inside_b:
                    area_b += area
                if inside_a and inside_b:
                    both += area
    return area_a, area_b, both
