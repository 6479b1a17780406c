"""The posterior surface as seen by a tilted camera through the anterior one."""

from collections.abc import Callable

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

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
    at = apparent_mm[:, 0]
    back = _first_root(
        lambda s: apparent_mm[:, 1] + s * down - surface.height(at, -s * deep),
        (np.interp(at, x, y) - apparent_mm[:, 1]) / down,
    )
    entry = np.column_stack([at, apparent_mm[:, 1] + back * down])
    z = -back * deep
    normal = surface.normal(at, z)
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
