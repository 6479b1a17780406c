"""Distances between contours, the measures that identify a section, and the check of a section.

Distances are exact, from points to the sides of a polyline. `check_section` refuses two surfaces
between which no mesh fits: they run back, cross, are exchanged or nearly touch.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_outline import Section

# Number of sides that share a bounding box in the search for the nearest one.
SIDES_IN_CHUNK = 16


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
    chunks = (sides + SIDES_IN_CHUNK - 1) // SIDES_IN_CHUNK
    box = np.empty((chunks, 4))
    for c in range(chunks):
        first = c * SIDES_IN_CHUNK
        last = min(sides, first + SIDES_IN_CHUNK) + 1
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
    for i in range(chunk * SIDES_IN_CHUNK, min(len(xs) - 1, (chunk + 1) * SIDES_IN_CHUNK)):
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


# Half widths for the curvature of the anterior surface and for the thickness.
RADIUS_REACH_MM = 4.0
CENTRE_REACH_MM = 0.5
# Degree of the polynomial for a smooth surface at rest; accurate to 15 um on a Corvis frame.
SMOOTH_DEGREE = 4


class Bump(NamedTuple):
    """The largest distance of a surface from a smooth curve; positive out of the eye."""

    height_mm: float
    x_mm: float


@dataclass(frozen=True)
class SectionShape:
    """Measures of a section.

    Parameters
    ----------
    width_mm : float
        Extent of the anterior surface along x.
    radius_mm : float
        Radius of the circle through the anterior surface; negative if it curves into the eye.
    central_thickness_mm : float
        Mean over the middle millimetre, from the anterior surface to the posterior one.
    anterior_bump, posterior_bump : Bump
    """

    width_mm: float
    radius_mm: float
    central_thickness_mm: float
    anterior_bump: Bump
    posterior_bump: Bump


def shape_of(section: Section) -> SectionShape:
    """Return the measures of a section."""
    x = section.anterior_mm[:, 0]
    middle = (x[0] + x[-1]) / 2
    return SectionShape(
        width_mm=float(np.ptp(x)),
        radius_mm=signed_radius_mm(section.anterior_mm),
        central_thickness_mm=float(
            distances(section.anterior_mm, section.posterior_mm)[
                np.abs(x - middle) <= min(CENTRE_REACH_MM, np.ptp(x) / 4)
            ].mean()
        ),
        anterior_bump=_bump(section.anterior_mm),
        posterior_bump=_bump(section.posterior_mm),
    )


def signed_radius_mm(surface_mm: FloatArray) -> float:
    """Return the radius of the circle through a surface, negative if it is concave.

    Least squares of :math:`x^2 + y^2 + a x + b y + c` (I. Kasa, IEEE Trans. Instrum. Meas. 25
    (1976) 8) over the middle 8 mm; infinite for a straight line.

    Parameters
    ----------
    surface_mm : ndarray, shape (n, 2)
        From left to right; y points out of the eye.
    """
    x = surface_mm[:, 0]
    middle = (x[0] + x[-1]) / 2
    points = surface_mm[np.abs(x - middle) <= RADIUS_REACH_MM]
    points = points - points.mean(axis=0)
    matrix = np.column_stack([points, np.ones(len(points))])
    a, b, c = np.linalg.lstsq(matrix, -(points**2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(a * a / 4 + b * b / 4 - c, 0.0)))
    return radius if b > 0 else -radius


def depth_mm(undeformed: Section, deformed: Section, reach_mm: float) -> float:
    """Return the motion of the middle of the anterior surface into the eye.

    Parameters
    ----------
    undeformed, deformed : Section
        In one coordinate system.
    reach_mm : float
        Half width of the middle, over which the motion along y is averaged.

    Raises
    ------
    InputError
        If the two sections do not overlap there.
    """
    before, after = undeformed.anterior_mm, deformed.anterior_mm
    middle = (before[0, 0] + before[-1, 0]) / 2
    x = middle + np.linspace(-reach_mm, reach_mm, 41)
    x = x[(x >= after[0, 0]) & (x <= after[-1, 0])]
    if not len(x):
        raise InputError(
            f"The deformed section spans x = {after[0, 0]:.2f} to {after[-1, 0]:.2f} mm, but the "
            f"middle of the undeformed section is at x = {middle:.2f} mm. Set first_pixel: the "
            "column and row of each picture's first pixel on the camera sensor."
        )
    return float(np.mean(np.interp(x, *before.T) - np.interp(x, *after.T)))


def _bump(surface_mm: FloatArray) -> Bump:
    x, y = surface_mm.T
    over = (x - x.mean()) / np.ptp(x)
    left = y - np.polynomial.Polynomial.fit(over, y, SMOOTH_DEGREE)(over)
    at = int(np.argmax(np.abs(left)))
    return Bump(float(left[at]), float(x[at]))


# Smallest distance between the surfaces; a cornea is 450 to 700 um thick.
MIN_THICKNESS_MM = 0.01


def check_section(section: Section) -> None:
    """Refuse a section that cannot be meshed.

    Parameters
    ----------
    section : Section
        An undeformed section.

    Raises
    ------
    InputError
        If x does not ascend along a surface, the surfaces cross or are exchanged, or their
        distance is less than 10 um (from a point of the anterior one).
    """
    for name, surface in (("anterior", section.anterior_mm), ("posterior", section.posterior_mm)):
        back = np.flatnonzero(np.diff(surface[:, 0]) <= 0)
        if len(back):
            raise InputError(
                f"The {name} surface runs back at x = {surface[back[0], 0]:.3f} mm (point "
                f"{back[0] + 1} of {len(surface)}). Give its points from left to right, each once."
            )
    crossing = _first_crossing(
        np.ascontiguousarray(section.anterior_mm), np.ascontiguousarray(section.posterior_mm)
    )
    if np.isfinite(crossing):
        raise InputError(
            f"The anterior and the posterior surface cross at x = {crossing:.3f} mm. "
            "Check the segmentation there, or give the two contours again."
        )
    outline = section.outline_mm
    following = np.roll(outline, -1, axis=0)
    area = 0.5 * np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0])
    if area >= 0:
        raise InputError(
            "The anterior surface is below the posterior one. Exchange the two contours; "
            "y points out of the eye."
        )
    gaps = distances(section.anterior_mm, section.posterior_mm)
    thin, x = float(gaps.min()), float(section.anterior_mm[np.argmin(gaps), 0])
    if thin < MIN_THICKNESS_MM:
        raise InputError(
            f"The cornea is {1000 * thin:.1f} um thick at x = {x:.3f} mm; at least "
            f"{1000 * MIN_THICKNESS_MM:.0f} um are needed. Check the two contours there."
        )


@njit(cache=True, nogil=True)
def _first_crossing(upper: FloatArray, lower: FloatArray) -> float:
    """Return x at the first crossing of two polylines with ascending x, or infinity."""
    j = 0
    for i in range(len(upper) - 1):
        ax, ay = upper[i]
        bx, by = upper[i + 1]
        while j > 0 and lower[j, 0] > ax:
            j -= 1
        while j < len(lower) - 2 and lower[j + 1, 0] < ax:
            j += 1
        k = j
        while k < len(lower) - 1 and lower[k, 0] <= bx:
            cx, cy = lower[k]
            dx, dy = lower[k + 1]
            left = max(ax, cx)
            right = min(bx, dx)
            if right >= left:
                fl = ay + (by - ay) * (left - ax) / (bx - ax)
                fl -= cy + (dy - cy) * (left - cx) / (dx - cx)
                fr = ay + (by - ay) * (right - ax) / (bx - ax)
                fr -= cy + (dy - cy) * (right - cx) / (dx - cx)
                if fl * fr < 0 or (fl == 0 and fr == 0 and right > left):
                    return left if fl == fr else left + (right - left) * fl / (fl - fr)
            k += 1
    return np.inf
