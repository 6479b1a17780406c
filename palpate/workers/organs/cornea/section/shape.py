"""Measures that identify a corneal section."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.contour_distance import distances
from palpate.workers.organs.cornea.section.outline import Section

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
