"""Describe the nominal physics of a breast between plates, and where reality may differ.

Distances are in mm; stiffness goes by factors and lengths, so nothing here has a unit of
stress but the wall's springs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from palpate.storage.values import FloatArray, Triple

Field = Callable[[FloatArray], FloatArray]
"""From points (k, 3) in mm to a number at each of them, (k,)."""

WALL_SPRING_KPA_PER_MM = 0.2
NU = 0.49


@dataclass(frozen=True, slots=True)
class Anatomy:
    """Give size and inside of a breast: two half ellipsoids on the chest wall.

    Parameters
    ----------
    seed : int
        Of the compartments.
    lower_mm, upper_mm, half_width_mm, depth_mm : float
        Semi-axes below and above the nipple (x), across (y) and deep (z).
    compartments : int
    glandular_fraction : float
    """

    seed: int
    lower_mm: float
    upper_mm: float
    half_width_mm: float
    depth_mm: float
    compartments: int
    glandular_fraction: float

    @property
    def centre_mm(self) -> Triple:
        """Return the middle of the box around the body."""
        return (self.upper_mm - self.lower_mm) / 2, 0.0, self.depth_mm / 2

    @property
    def half_mm(self) -> Triple:
        """Return half the sides of that box."""
        return (self.upper_mm + self.lower_mm) / 2, self.half_width_mm, self.depth_mm / 2

    def normalised(self, points: FloatArray) -> FloatArray:
        """Scale points (k, 3) to -1 and 1 on the faces of the box."""
        return np.asarray((points - self.centre_mm) / np.asarray(self.half_mm))

    def skin(self, count: int = 4000) -> tuple[FloatArray, FloatArray]:
        """Spread points (count, 3) over the ellipsoids and return the area of each, in mm^2.

        On the unit sphere they are a Fibonacci lattice; a point n has the area
        ``det A |A^-1 n|`` times that on the sphere, A the diagonal matrix of the semi-axes.
        """
        z = (np.arange(count) + 0.5) / count
        turn = np.pi * (1 + math.sqrt(5)) * np.arange(count)
        r = np.sqrt(1 - z * z)
        sphere = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        axes = self._axes(sphere)
        stretch = axes.prod(axis=1) * np.linalg.norm(sphere / axes, axis=1)
        return sphere * axes, 2 * np.pi / count * stretch

    def depth_inside(self, points: FloatArray) -> FloatArray:
        """Return how far points (k, 3) lie inside the ellipsoids, in mm, roughly."""
        axes = self._axes(points)
        scaled = np.linalg.norm(points / axes, axis=1)
        return np.asarray((1 - scaled) * axes.min(axis=1))

    def _axes(self, points: FloatArray) -> FloatArray:
        """Return the semi-axes of the ellipsoid that each point (k, 3) belongs to, (k, 3)."""
        along = np.where(points[:, 0] < 0, self.lower_mm, self.upper_mm)
        others = np.full((len(points), 2), (self.half_width_mm, self.depth_mm))
        return np.column_stack([along, others])


@dataclass(frozen=True, slots=True)
class Constants:
    """Hold what a diagnosis does not know, in kPa."""

    E_fat_kpa: float
    E_gl_kpa: float
    eta_kpa: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Hold all that a solution depends on; without changes, the nominal physics.

    Parameters
    ----------
    anatomy : Anatomy
    constants : Constants
    gravity_g : tuple of float
        That of the loaded scans less that of the reference scan.
    force_factor : float
        Share of the plate's force that the body carries.
    tilt_deg : tuple of float
        Of the upper plate, about the first in-plane axis (the axis of compression x z)
        and about z.
    sag_mm : float
        By which the upper plate bends away, 50 mm across from its pivot.
    plate_edge_mm : float
        z at which both plates begin.
    friction : tuple of Field
        Coulomb's coefficients; they add up.
    wall_compliance : Field or None
        Of the chest wall along z, in mm/kPa.
    wall_rise_mm : Field or None
        How far the chest wall moves forward before the plates press.
    wall_grip : Field or None
        Springs along the chest wall on top of the nominal ones, in kPa/mm.
    skin_grip : Field or None
        Springs on the skin along all axes, in kPa/mm.
    ln_stiffness : tuple of Field
        ln of factors on all moduli.
    fibres : callable or None
        From points (k, 3) to unit vectors (k, 3).
    ln_gland_fibres : Field or None
        ln of the fibres' stiffness in glandular tissue over that in fat.
    fung : float
        Exponent of Fung's law.
    growth : tuple of callable
        From points (k, 3) and whether each is glandular (k,) to stretches at which the
        tissue is free of stress, less 1.
    skin_n_per_m : float
        E t of a skin.
    segmentation_mm : tuple of float
        How far the outline and the glandular labels of the loaded scans reach too far.
    image_scale : tuple of float
        By which part the loaded scans are drawn too large along x, y and z, about the middle
        of the body.
    nu : float
        Poisson's ratio.
    wall_spring_factor : float
        On the springs along the chest wall.
    """

    anatomy: Anatomy
    constants: Constants
    gravity_g: Triple = (0.0, 0.0, 0.0)
    force_factor: float = 1.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    sag_mm: float = 0.0
    plate_edge_mm: float = -math.inf
    friction: tuple[Field, ...] = ()
    wall_compliance: Field | None = None
    wall_rise_mm: Field | None = None
    wall_grip: Field | None = None
    skin_grip: Field | None = None
    ln_stiffness: tuple[Field, ...] = ()
    fibres: Callable[[FloatArray], FloatArray] | None = None
    ln_gland_fibres: Field | None = None
    fung: float = 0.0
    growth: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...] = ()
    skin_n_per_m: float = 0.0
    segmentation_mm: tuple[float, float] = field(default=(0.0, 0.0))
    image_scale: Triple = (0.0, 0.0, 0.0)
    nu: float = NU
    wall_spring_factor: float = 1.0

    def drawn(self, places: FloatArray) -> FloatArray:
        """Return where a loaded scan draws what is at these places (n, 3)."""
        away = places - np.asarray(self.anatomy.centre_mm)
        return np.asarray(places + np.asarray(self.image_scale) * away)
