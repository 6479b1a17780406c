"""Validation of the two surfaces of a cornea."""

import numpy as np
from numba import njit

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.contour_distance import distances
from palpate.workers.organs.cornea.section.outline import Section

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
    at = _first_crossing(
        np.ascontiguousarray(section.anterior_mm), np.ascontiguousarray(section.posterior_mm)
    )
    if np.isfinite(at):
        raise InputError(
            f"The anterior and the posterior surface cross at x = {at:.3f} mm. "
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
