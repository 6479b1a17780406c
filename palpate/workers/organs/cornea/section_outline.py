"""A section through a cornea: two surfaces as polylines, from radii or corrected for refraction.

A section is generated from radii, diameter and thickness, cropped between two vertical lines,
and moved by a rotation and a shift in its plane. In an image a tilted camera sees the posterior
surface through the anterior one; `corrected_posterior` returns it to its place.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, eq=False)
class Section:
    """The two surfaces of a corneal section, from the left to the right limbus.

    The x axis points along the chord from limbus to limbus, the y axis out of the eye, so the
    anterior surface has the larger y. Both surfaces start at the left edge of the section and
    end at the right edge.

    Parameters
    ----------
    anterior_mm, posterior_mm : ndarray, shape (k, 2) and (m, 2)
        Points of the outer and the inner surface, x ascending along the undeformed ones.

    Raises
    ------
    InputError
        If a surface has fewer than three points or a coordinate is not finite.
    """

    anterior_mm: FloatArray
    posterior_mm: FloatArray

    def __post_init__(self) -> None:
        for name, surface in (("anterior", self.anterior_mm), ("posterior", self.posterior_mm)):
            if surface.ndim != 2 or surface.shape[1] != 2 or len(surface) < 3:
                raise InputError(
                    f"The {name} surface of a cornea needs at least three points (x, y) in mm, "
                    f"found an array of shape {surface.shape}."
                )
            if not np.isfinite(surface).all():
                raise InputError(
                    f"The {name} surface of the cornea has coordinates that are not "
                    "finite. Check the segmentation of the image."
                )

    @property
    def outline_mm(self) -> FloatArray:
        """Return the closed polygon: anterior surface left to right, posterior surface back."""
        return np.concatenate([self.anterior_mm, self.posterior_mm[::-1]])


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


@dataclass(frozen=True)
class RigidMotion:
    """A rotation about a centre, followed by a shift.

    Parameters
    ----------
    shift_mm : tuple of float
        Along x and y.
    tilt_rad : float
        Counter-clockwise.
    centre_mm : tuple of float
        Centre of the rotation.
    """

    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_rad: float = 0.0
    centre_mm: tuple[float, float] = (0.0, 0.0)

    def of_points(self, points_mm: FloatArray) -> FloatArray:
        """Return the moved points, shape (n, 2)."""
        cos, sin = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        turn = np.array([[cos, -sin], [sin, cos]])
        arms = points_mm - np.array(self.centre_mm)
        return np.asarray(arms @ turn.T + self.centre_mm + self.shift_mm)

    def of_section(self, section: Section) -> Section:
        """Return the moved section."""
        return Section(
            anterior_mm=self.of_points(section.anterior_mm),
            posterior_mm=self.of_points(section.posterior_mm),
        )

    @property
    def inverse(self) -> "RigidMotion":
        """Return the inverse motion."""
        centre = (self.centre_mm[0] + self.shift_mm[0], self.centre_mm[1] + self.shift_mm[1])
        shift = (-self.shift_mm[0], -self.shift_mm[1])
        return RigidMotion(shift_mm=shift, tilt_rad=-self.tilt_rad, centre_mm=centre)


def cropped_section(section: Section, first_x_mm: float, last_x_mm: float) -> Section:
    """Return the part of a section within a range of x, as shown by a frame.

    A simulated section extends from limbus to limbus, a frame does not: both are cropped to
    their common range before they are compared.

    Parameters
    ----------
    section : Section
        Each of its surfaces crosses each line once.
    first_x_mm, last_x_mm : float
        Ascending; a line beyond an end of a surface leaves that end unchanged.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If a surface is outside the two lines, or crosses one of them more than once.
    """
    return Section(
        anterior_mm=_cropped(section.anterior_mm, first_x_mm, last_x_mm),
        posterior_mm=_cropped(section.posterior_mm, first_x_mm, last_x_mm),
    )


def _cropped(surface: FloatArray, first: float, last: float) -> FloatArray:
    x = surface[:, 0]
    inside = np.flatnonzero((x > first) & (x < last))
    if len(inside) < 2 or np.any(np.diff(inside) != 1):
        raise InputError(
            f"A surface from x = {x[0]:.3f} to {x[-1]:.3f} mm cannot be cropped to {first:.3f} to "
            f"{last:.3f} mm: it is outside, or crosses a border more than once."
        )
    begin, end = inside[0], inside[-1]
    pieces = [surface[begin : end + 1]]
    if begin > 0:
        pieces.insert(0, _on_line(surface[begin - 1], surface[begin], first)[None])
    if end < len(x) - 1:
        pieces.append(_on_line(surface[end], surface[end + 1], last)[None])
    return np.concatenate(pieces)


def _on_line(a: FloatArray, b: FloatArray, x: float) -> FloatArray:
    """Return the point at x on the line through two points."""
    return np.array([x, a[1] + (b[1] - a[1]) * (x - a[0]) / (b[0] - a[0])])


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


# Refractive index of the cornea for visible light.
CORNEA_INDEX = 1.376
# Angle from which a Scheimpflug camera views the plane of the light slit.
CAMERA_ANGLE_DEG = 45.0


def corrected_posterior(
    anterior_mm: FloatArray,
    apparent_mm: FloatArray,
    index: float = CORNEA_INDEX,
    camera_angle_deg: float = CAMERA_ANGLE_DEG,
    axis_x_mm: float | None = None,
) -> FloatArray:
    r"""Return the true positions of a posterior surface, given its apparent ones.

    The section is illuminated by a slit in the plane z = 0. The camera's parallel rays
    :math:`d = (0, -\cos\alpha, \sin\alpha)` meet the anterior surface in front of that plane,
    are refracted by Snell's law in three dimensions, and end in the plane. In the image, which
    is scaled for air, a point appears where the ray would have met the plane without
    refraction. Out of the plane, the anterior surface :math:`f` is curved like the surface of
    revolution of its even part :math:`e` about a vertical axis,
    :math:`y = f(x) + e(\sqrt{x^2 + z^2}) - e(x)`. Behind a flat surface the depth is
    :math:`\tan\alpha / \tan\alpha'` times the apparent one with
    :math:`\sin\alpha = n \sin\alpha'`: 1.67 times at 45 degrees, 1.376 times head on.

    Parameters
    ----------
    anterior_mm : ndarray, shape (k, 2)
        x ascending.
    apparent_mm : ndarray, shape (m, 2)
        Below the anterior surface.
    index : float
        Refractive index; >= 1.
    camera_angle_deg : float
        Between the rays of the camera and the y axis; above 0, below 80.
    axis_x_mm : float
        x of the axis of revolution; the middle of the anterior surface by default.

    Returns
    -------
    ndarray, shape (m, 2)

    Raises
    ------
    InputError
        If the index, the angle or the order of the points is invalid, or a point is above the
        anterior surface.
    """
    if not (np.isfinite(index) and index >= 1):
        raise InputError(f"A refractive index must be at least 1 (cornea: 1.376), got {index}.")
    if not 0 < camera_angle_deg < 80:
        raise InputError(
            f"The angle of the camera must be between 0 and 80 degrees, got {camera_angle_deg}."
        )
    x, y = anterior_mm.T
    if np.any(np.diff(x) <= 0):
        raise InputError("The anterior surface doubles back. Give its points from left to right.")
    if np.any(apparent_mm[:, 1] > np.interp(apparent_mm[:, 0], x, y)):
        raise InputError("The posterior surface is above the anterior one in places.")
    surface = _AnteriorSurface(
        anterior_mm, 0.5 * float(x[0] + x[-1]) if axis_x_mm is None else axis_x_mm
    )
    angle = np.deg2rad(camera_angle_deg)
    down, deep = float(np.cos(angle)), float(np.sin(angle))
    apparent_x = apparent_mm[:, 0]
    back = _first_root(
        lambda s: apparent_mm[:, 1] + s * down - surface.height(apparent_x, -s * deep),
        (np.interp(apparent_x, x, y) - apparent_mm[:, 1]) / down,
    )
    entry = np.column_stack([apparent_x, apparent_mm[:, 1] + back * down])
    z = -back * deep
    normal = surface.normal(apparent_x, z)
    ray = np.array([0.0, -down, deep])
    cosine = -normal @ ray
    ratio = 1 / index
    along_normal = ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))
    bent = ratio * ray + along_normal[:, None] * normal
    return np.asarray(entry - (z / bent[:, 2])[:, None] * bent[:, :2])


class _AnteriorSurface:
    """The anterior surface over the plane (x, z), extended by straight lines."""

    def __init__(self, anterior: FloatArray, axis: float) -> None:
        self._x, self._y = anterior.T
        self._axis = axis
        self._slope = np.gradient(self._y, self._x)
        widest = max(axis - self._x[0], self._x[-1] - axis)
        # Rays may enter up to a thickness beyond the ends of the section.
        self._r = np.linspace(-1.2 * widest, 1.2 * widest, 2 * len(self._x) + 1)
        self._even = 0.5 * (self._profile(axis + self._r) + self._profile(axis - self._r))
        self._even_slope = np.gradient(self._even, self._r)

    def _profile(self, x: FloatArray) -> FloatArray:
        left, right = np.minimum(x - self._x[0], 0.0), np.maximum(x - self._x[-1], 0.0)
        inside = np.interp(x, self._x, self._y)
        return np.asarray(inside + left * self._slope[0] + right * self._slope[-1])

    def height(self, x: FloatArray, z: FloatArray) -> FloatArray:
        aside = x - self._axis
        rise = np.interp(np.hypot(aside, z), self._r, self._even)
        return np.asarray(self._profile(x) + rise - np.interp(aside, self._r, self._even))

    def normal(self, x: FloatArray, z: FloatArray) -> FloatArray:
        """Return outward unit normals, shape (n, 3)."""
        aside = x - self._axis
        radius = np.maximum(np.hypot(aside, z), 1e-12)
        along_r = np.interp(radius, self._r, self._even_slope)
        along_x = np.interp(x, self._x, self._slope) + along_r * aside / radius
        along_x -= np.interp(aside, self._r, self._even_slope)
        normal = np.stack([-along_x, np.ones_like(x), -along_r * z / radius], axis=1)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _first_root(function: Callable[[FloatArray], FloatArray], guess: FloatArray) -> FloatArray:
    """Return the roots of functions that are not positive at zero, by bisection."""
    low, high = np.zeros_like(guess), np.maximum(guess, 1e-9)
    for _ in range(20):
        high = np.where(function(high) < 0, 1.5 * high, high)
    for _ in range(50):
        middle = 0.5 * (low + high)
        under = function(middle) < 0
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return np.asarray(0.5 * (low + high))
