"""A corneal section from radii, diameter and thickness."""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.outline import Section


def generated_section(
    anterior_radius_mm: float = 7.8,
    diameter_mm: float = 11.7,
    central_thickness_mm: float = 0.595,
    peripheral_thickness_mm: float = 0.70,
    asphericity: float = 0.0,
    points: int = 601,
) -> Section:
    r"""Return a symmetric section between a conic and a circular arc.

    The anterior surface is the conic :math:`x^2 + (1 + Q) z^2 = 2 R z` with the sag
    :math:`z` below the apex, a circle of radius :math:`R` for :math:`Q = 0`. The
    posterior surface is the circular arc through the point at the central thickness
    below the apex and through the two points at the peripheral thickness from the ends
    of the anterior surface, along its normals. All points are exactly on their curves.
    The ends of the anterior surface have y = 0, its apex x = 0.

    The default is the geometry of the measurements in the thesis (chapter 5): radius 7.8 mm,
    chord 11.7 mm, thickness 0.595 to 0.70 mm.

    Parameters
    ----------
    anterior_radius_mm : float
        Radius of curvature at the apex; > 0.
    diameter_mm : float
        Chord of the anterior surface from limbus to limbus; > 0.
    central_thickness_mm, peripheral_thickness_mm : float
        Thickness at the apex, and at the limbus along the anterior normal; > 0.
    asphericity : float
        Conic constant Q: 0 a circle, -0.2 a typical cornea, flatter outwards.
    points : int
        Number of points per surface, odd so that one is on the axis; at least 3.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If a length is not positive, the conic does not reach the diameter, the posterior
        surface is not an arc over the whole section, or `points` is even or below 3.
    """
    lengths = {
        "anterior radius": anterior_radius_mm,
        "diameter": diameter_mm,
        "central thickness": central_thickness_mm,
        "peripheral thickness": peripheral_thickness_mm,
    }
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"The {name} of a cornea must be a positive length, got {value} mm.")
    if points < 3 or points % 2 == 0:
        raise InputError(f"A surface needs an odd number of points, 3 or more, got {points}.")
    half = diameter_mm / 2
    if (1 + asphericity) * half**2 >= anterior_radius_mm**2:
        raise InputError(
            f"A surface of radius {anterior_radius_mm} mm and asphericity {asphericity} does not "
            f"reach a diameter of {diameter_mm} mm. Give a larger radius or a smaller diameter."
        )
    # Equal steps of the angle on a circle of this radius; on other conics nearly even steps.
    widest = np.arcsin(min(half / anterior_radius_mm, 0.999))
    side = np.sin(np.linspace(0.0, widest, points // 2 + 1)) * (half / np.sin(widest))
    side[-1] = half
    x = np.concatenate([-side[:0:-1], side])
    sag = _conic_sag(x, anterior_radius_mm, asphericity)
    anterior = np.column_stack([x, sag[-1] - sag])
    posterior = _posterior_arc(
        anterior_radius_mm,
        asphericity,
        half,
        float(sag[-1]),
        (central_thickness_mm, peripheral_thickness_mm),
        points,
    )
    return Section(anterior_mm=anterior, posterior_mm=posterior)


def _conic_sag(x: FloatArray, radius: float, q: float) -> FloatArray:
    """Return the depth of a conic below its apex; stable at Q = -1 (a parabola)."""
    return x**2 / (radius * (1 + np.sqrt(1 - (1 + q) * x**2 / radius**2)))


def _posterior_arc(
    radius: float,
    q: float,
    half: float,
    sagitta: float,
    thickness: tuple[float, float],
    points: int,
) -> FloatArray:
    central, peripheral = thickness
    slope = half / np.sqrt(radius**2 - (1 + q) * half**2)
    normal = np.array([slope, 1.0]) / np.hypot(slope, 1.0)
    end = np.array([half, 0.0]) - peripheral * normal
    top = sagitta - central
    depth = top - end[1]
    if not (end[0] > 0 and 0 < depth < end[0]):
        raise InputError(
            f"A central thickness of {central} mm and a peripheral one of {peripheral} mm leave no "
            f"posterior arc under an anterior surface {2 * half} mm wide and {sagitta:.3f} mm high."
        )
    inner = (end[0] ** 2 + depth**2) / (2 * depth)
    side = np.linspace(0.0, np.arcsin(end[0] / inner), points // 2 + 1)
    x = inner * np.sin(side)
    y = top - 2 * inner * np.sin(side / 2) ** 2
    return np.column_stack([np.concatenate([-x[:0:-1], x]), np.concatenate([y[:0:-1], y])])
