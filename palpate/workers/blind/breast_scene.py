"""The nominal physics of a breast between plates, and the interface of causes that change it.

Distances are in mm; stiffnesses are given by factors and lengths, so only the wall's springs have a
unit of stress.

A cause is a deviation from the nominal physics in its own mathematical form. It is drawn for an
anatomy and applied to a scene. Magnitudes are log-uniform over a plausible range, so that the
effects of some are below the noise of a segmentation.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, Self

import numpy as np

from palpate.storage.values import FloatArray, Triple

Field = Callable[[FloatArray], FloatArray]
"""Function from points (k, 3) in mm to a number at each point, (k,)."""

WALL_SPRING_KPA_PER_MM = 0.2
NU = 0.49


@dataclass(frozen=True, slots=True)
class Anatomy:
    """Size and interior of a breast: two half ellipsoids on the chest wall.

    Parameters
    ----------
    seed : int
        Seed from which the compartments are generated.
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
        """Return the centre of the bounding box of the body."""
        return (self.upper_mm - self.lower_mm) / 2, 0.0, self.depth_mm / 2

    @property
    def half_mm(self) -> Triple:
        """Return half the side lengths of the bounding box."""
        return (self.upper_mm + self.lower_mm) / 2, self.half_width_mm, self.depth_mm / 2

    def normalised(self, points: FloatArray) -> FloatArray:
        """Scale points (k, 3) so that the faces of the bounding box are at -1 and 1."""
        return np.asarray((points - self.centre_mm) / np.asarray(self.half_mm))

    def skin(self, count: int = 4000) -> tuple[FloatArray, FloatArray]:
        """Return points (count, 3) spread over the ellipsoids, and the area around each in mm^2.

        On the unit sphere they are a Fibonacci lattice; the area of a point n is ``det A |A^-1 n|``
        times its area on the sphere, with A the diagonal matrix of the semi-axes.
        """
        z = (np.arange(count) + 0.5) / count
        turn = np.pi * (1 + math.sqrt(5)) * np.arange(count)
        r = np.sqrt(1 - z * z)
        sphere = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        axes = self._axes(sphere)
        stretch = axes.prod(axis=1) * np.linalg.norm(sphere / axes, axis=1)
        return sphere * axes, 2 * np.pi / count * stretch

    def depth_inside(self, points: FloatArray) -> FloatArray:
        """Return the approximate depth of points (k, 3) inside the ellipsoids, in mm."""
        axes = self._axes(points)
        scaled = np.linalg.norm(points / axes, axis=1)
        return np.asarray((1 - scaled) * axes.min(axis=1))

    def _axes(self, points: FloatArray) -> FloatArray:
        """Return the semi-axes (k, 3) of the ellipsoid that contains each point (k, 3)."""
        along = np.where(points[:, 0] < 0, self.lower_mm, self.upper_mm)
        others = np.full((len(points), 2), (self.half_width_mm, self.depth_mm))
        return np.column_stack([along, others])


@dataclass(frozen=True, slots=True)
class Constants:
    """Constants to be found by a diagnosis, in kPa."""

    E_fat_kpa: float
    E_gl_kpa: float
    eta_kpa: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Complete input of the solver; by default, the nominal physics.

    Parameters
    ----------
    anatomy : Anatomy
    constants : Constants
    gravity_g : tuple of float
        Gravity of the loaded scans minus gravity of the reference scan.
    force_factor : float
        Fraction of the plate's force that the body carries.
    tilt_deg : tuple of float
        Tilt of the upper plate, about the first in-plane axis (the axis of compression x z)
        and about z.
    sag_mm : float
        Distance by which the upper plate is bent away, 50 mm across from its pivot.
    plate_edge_mm : float
        z at which both plates start.
    friction : tuple of Field
        Coulomb coefficients; they add up.
    wall_compliance : Field or None
        Compliance of the chest wall along z, in mm/kPa.
    wall_rise_mm : Field or None
        Forward motion of the chest wall before compression.
    wall_grip : Field or None
        Springs along the chest wall in addition to the nominal ones, in kPa/mm.
    skin_grip : Field or None
        Springs on the skin along all axes, in kPa/mm.
    ln_stiffness : tuple of Field
        ln of factors on all moduli.
    fibres : callable or None
        Function from points (k, 3) to unit vectors (k, 3).
    ln_gland_fibres : Field or None
        ln of the ratio of the fibres' stiffness in glandular tissue to their stiffness in fat.
    fung : float
        Exponent of Fung's law.
    growth : tuple of callable
        Functions from points (k, 3) and their glandular flags (k,) to stress-free stretches minus
        1.
    skin_n_per_m : float
        Tensile stiffness E t of the skin.
    segmentation_mm : tuple of float
        Distances by which the outline and the glandular labels of the loaded scans extend too far.
    image_scale : tuple of float
        Relative enlargement of the loaded scans along x, y and z, about the centre of the body.
    nu : float
        Poisson's ratio.
    wall_spring_factor : float
        Factor on the springs along the chest wall.
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
        """Return the positions of points (n, 3) as drawn in a loaded scan."""
        away = places - np.asarray(self.anatomy.centre_mm)
        return np.asarray(places + np.asarray(self.image_scale) * away)


Rng = np.random.Generator


class Cause(Protocol):
    """A single deviation from the nominal physics.

    ``kind`` is its name here; ``effect`` and ``family`` are the correct answers of a diagnosis,
    None if there is none. Its fields are the parameters, with units in their names.
    """

    kind: ClassVar[str]
    effect: ClassVar[str | None]
    family: ClassVar[str | None]

    @classmethod
    def draw(cls, rng: Rng, anatomy: Anatomy) -> Self:
        """Draw a random cause for an anatomy."""
        ...

    def apply_to(self, scene: Scene) -> Scene:
        """Return the scene with this deviation."""
        ...


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform between the logarithms of `low` and `high`."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def sign(rng: Rng) -> float:
    """Draw 1 or -1 with equal probability."""
    return 1.0 if rng.random() < 0.5 else -1.0


def direction(rng: Rng) -> Triple:
    """Draw a unit vector, uniformly distributed."""
    vector = rng.standard_normal(3)
    return triple(vector / np.linalg.norm(vector))


def triple(vector: FloatArray) -> Triple:
    """Return the three numbers of an array (3,)."""
    x, y, z = vector.tolist()
    return x, y, z
