"""Loads and boundary conditions, and the regions of a body where they act.

Loads are plates, pressure and forces; the body is held by `Hold`, the chest wall and attachments.
A region is defined by undeformed coordinates, so that it applies to any mesh. `Pressed` describes
compression between plates for drawings.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, Triple


@dataclass(frozen=True, slots=True)
class Box:
    """Points between two corners, in mm; an infinite coordinate leaves a side open."""

    lower_mm: Triple
    upper_mm: Triple

    def __post_init__(self) -> None:
        if any(a > b for a, b in zip(self.lower_mm, self.upper_mm, strict=True)):
            raise InputError(f"A box needs lower <= upper, got {self.lower_mm} and {self.upper_mm}")

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is inside the box grown by `margin_mm`."""
        low = np.asarray(self.lower_mm) - margin_mm
        high = np.asarray(self.upper_mm) + margin_mm
        return np.asarray(((points >= low) & (points <= high)).all(axis=1))


@dataclass(frozen=True, slots=True)
class Ball:
    """Points within `radius_mm` of a centre."""

    centre_mm: Triple
    radius_mm: float

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is inside the ball grown by `margin_mm`."""
        distance = np.linalg.norm(points - np.asarray(self.centre_mm), axis=1)
        return np.asarray(distance <= self.radius_mm + margin_mm)


@dataclass(frozen=True, slots=True)
class OutsideCircle:
    """Points at least `radius_mm` from an axis along z through `centre_mm`, (x, y)."""

    centre_mm: tuple[float, float]
    radius_mm: float

    def contains(self, points: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Test whether each of `points`, shape (k, 3), is outside a circle `margin_mm` smaller."""
        return np.asarray(self._from_axis(points) >= self.radius_mm - margin_mm)

    def away(self, points: FloatArray) -> FloatArray:
        """Return the distance from points inside the circle to it, shape (k,)."""
        return np.asarray(self.radius_mm - self._from_axis(points))

    def _from_axis(self, points: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(points[:, :2] - np.asarray(self.centre_mm), axis=1))


Region = Box | Ball | OutsideCircle

EVERYWHERE = Box((-np.inf, -np.inf, -np.inf), (np.inf, np.inf, np.inf))


def nodes_in(region: Region, nodes: FloatArray, margin_mm: float) -> BoolArray:
    """Find the `nodes`, shape (n, 3), that belong to a region: at least the nearest one.

    A coarse mesh may have no node inside a small region; nodes within `margin_mm`, or else the
    nearest one, are then used.
    """
    inside = region.contains(nodes)
    if not inside.any():
        inside = region.contains(nodes, margin_mm)
    if not inside.any():
        inside[np.argmin(_distance(region, nodes))] = True
    return inside


def _distance(region: Region, nodes: FloatArray) -> FloatArray:
    """Return the distance of `nodes` from a region that contains none of them, shape (n,)."""
    if isinstance(region, Ball):
        return np.asarray(np.linalg.norm(nodes - np.asarray(region.centre_mm), axis=1))
    if isinstance(region, OutsideCircle):
        return region.away(nodes)
    nearest = np.clip(nodes, region.lower_mm, region.upper_mm)
    return np.asarray(np.linalg.norm(nodes - nearest, axis=1))


@dataclass(frozen=True, slots=True)
class Plate:
    """Deviation of one plate from a flat plane normal to the axis of compression.

    Parameters
    ----------
    tilt_deg : tuple of float
        Rotation about the first and the second in-plane axis; see `Device`.
    bow_per_mm : tuple of float
        Curvature along the first and the second in-plane axis, positive where the
        plate bends away from the body.
    """

    tilt_deg: tuple[float, float] = (0.0, 0.0)
    bow_per_mm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Device:
    """Position and motion of two rigid plates.

    For compression along y the in-plane axes are x and z. In general the second is z
    minus its component along the axis, and the first is axis x second.

    Parameters
    ----------
    axis : tuple of float
        From the lower to the upper plate: (0, 1, 0) cranio-caudal, (s, s, 0)
        with s = sqrt(1/2) mediolateral oblique at 45 degrees.
    pivot_mm : tuple of float
        Point at which tilt and bow do not change the plate's distance.
    lower, upper : Plate
    lower_share : float
        Share of the travel made by the lower plate, 0 to 1.
    friction : float
        Coulomb friction coefficient between skin and both plates.
    edge_mm : float, optional
        Start of the flat part of both plates along the second in-plane axis; behind it their
        rounding curves away from the body. None for plates without an edge.
    """

    axis: Triple = (0.0, 1.0, 0.0)
    pivot_mm: Triple = (0.0, 0.0, 0.0)
    lower: Plate = Plate()
    upper: Plate = Plate()
    lower_share: float = 0.0
    friction: float = 0.0
    edge_mm: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.lower_share <= 1:
            raise InputError(
                "The lower plate's share of the travel must be from 0 to 1, got "
                f"{self.lower_share}."
            )
        if not np.linalg.norm(np.cross(self.axis, (0.0, 0.0, 1.0))) > 1e-6:
            raise InputError(
                f"The axis of compression must not be along z, which runs from chest wall "
                f"to nipple; got {self.axis}."
            )


@dataclass(frozen=True, slots=True)
class ForceControl:
    """Plates that are pushed together until they carry `force_n`.

    They start at `lower_mm` and `upper_mm` along the axis of the device.
    """

    force_n: float
    lower_mm: float
    upper_mm: float
    device: Device = Device()

    def __post_init__(self) -> None:
        if not self.force_n > 0:
            raise InputError(f"The plate force must be positive, got {self.force_n:g} N.")
        _check_plates(self.lower_mm, self.upper_mm)


@dataclass(frozen=True, slots=True)
class DistanceControl:
    """Plates that end at `lower_mm` and `upper_mm`, whatever the force."""

    lower_mm: float
    upper_mm: float
    device: Device = Device()

    def __post_init__(self) -> None:
        _check_plates(self.lower_mm, self.upper_mm)


@dataclass(frozen=True, slots=True)
class NoPlates:
    """Load without plates; gravity, pressure, forces and holds may act."""

    device: Device = Device()


Load = ForceControl | DistanceControl | NoPlates


@dataclass(frozen=True, slots=True)
class Pressure:
    """Pressure on the free surface inside a region, normal to the deformed surface.

    Positive pushes inwards.
    """

    pressure_mpa: float
    region: Region = EVERYWHERE


@dataclass(frozen=True, slots=True)
class DeadForce:
    """Force of constant direction, distributed evenly over the nodes of a region."""

    force_n: Triple
    region: Region


@dataclass(frozen=True, slots=True)
class DisplacementField:
    """Interpolated displacements, known at some points.

    The interpolant is an affine map, fitted by least squares, plus biharmonic functions for its
    residuals, the linear kernel of M. D. Buhmann, Radial Basis Functions (2003). The points may
    be in one plane.
    """

    points_mm: tuple[Triple, ...]
    displacement_mm: tuple[Triple, ...]

    def at(self, points: FloatArray) -> FloatArray:
        """Return the displacement at points, (k, 3) in and out, in mm."""
        from scipy.interpolate import RBFInterpolator  # slow to import, and rarely needed

        known, moved = np.array(self.points_mm), np.array(self.displacement_mm)
        middle = known.mean(axis=0)
        affine = np.linalg.lstsq(_with_one(known - middle), moved)[0]
        rest = moved - _with_one(known - middle) @ affine
        field = RBFInterpolator(known, rest, kernel="linear", degree=0)
        return np.asarray(field(points) + _with_one(points - middle) @ affine)


def _with_one(points: FloatArray) -> FloatArray:
    return np.column_stack([points, np.ones(len(points))])


@dataclass(frozen=True, slots=True)
class Hold:
    """Displacement prescribed on the nodes of a region, along the held axes."""

    region: Region
    displacement_mm: Triple | DisplacementField = (0.0, 0.0, 0.0)
    axes: tuple[bool, bool, bool] = (True, True, True)

    def at(self, points: FloatArray) -> FloatArray:
        """Return the prescribed displacement at points of the region, (k, 3) in and out, in mm."""
        if isinstance(self.displacement_mm, DisplacementField):
            return self.displacement_mm.at(points)
        return np.tile(np.asarray(self.displacement_mm, np.float64), (len(points), 1))

    def scaled(self, factor: float) -> "Hold":
        """Return the hold with its displacement multiplied by a factor."""
        moved = self.displacement_mm
        if isinstance(moved, DisplacementField):
            each = tuple(_scaled(one, factor) for one in moved.displacement_mm)
            return replace(self, displacement_mm=replace(moved, displacement_mm=each))
        return replace(self, displacement_mm=_scaled(moved, factor))


def _scaled(moved: Triple, factor: float) -> Triple:
    x, y, z = moved
    return factor * x, factor * y, factor * z


@dataclass(frozen=True, slots=True)
class Wall:
    """Support of the body by the chest wall.

    Parameters
    ----------
    held : tuple of bool
        Whether each displacement component is zero.
    spring_mpa_per_mm : tuple of float
        Elastic foundation along the components that are not held: traction per
        displacement. With zero the wall slides.
    """

    held: tuple[bool, bool, bool] = (False, False, True)
    spring_mpa_per_mm: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if min(self.spring_mpa_per_mm) < 0:
            raise InputError(
                f"The chest wall needs springs >= 0, got {self.spring_mpa_per_mm} MPa/mm."
            )


SLIDING_WALL = Wall()


@dataclass(frozen=True, slots=True)
class Attachment:
    """Springs that hold a patch of the skin or of the chest wall in place.

    Their stiffness falls off with the distance d from the centre as ``exp(-d^2 / 2 r^2)``.

    Parameters
    ----------
    spring_mpa_per_mm : tuple of float
        Traction per displacement along x, y and z, >= 0.
    centre_mm : tuple of float
        Centre in the undeformed body.
    radius_mm : float
        r, > 0.
    """

    spring_mpa_per_mm: Triple
    centre_mm: Triple
    radius_mm: float

    def __post_init__(self) -> None:
        if not (min(self.spring_mpa_per_mm) >= 0 and self.radius_mm > 0):
            raise InputError(
                "An attachment needs springs >= 0 and a radius > 0, got "
                f"{self.spring_mpa_per_mm} MPa/mm and {self.radius_mm:g} mm."
            )

    def weight(self, points: FloatArray) -> FloatArray:
        """Return the relative stiffness at `points`, shape (k, 3); shape (k,)."""
        away = (points - np.asarray(self.centre_mm)) / self.radius_mm
        return np.asarray(np.exp(-0.5 * (away * away).sum(axis=1)))


def _check_plates(lower_mm: float, upper_mm: float) -> None:
    """Raise InputError if the plates are in the wrong order."""
    if not upper_mm > lower_mm:
        raise InputError(
            f"The upper plate ({upper_mm:g} mm along the axis) must be above the lower one "
            f"({lower_mm:g} mm)."
        )


ALONG_Y: Triple = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pressed:
    """Compression of a body between plates.

    Parameters
    ----------
    axis : tuple of float
        Direction from the lower to the upper plate.
    force_n : float or None
        Plate force; None for plates at a given distance.
    """

    axis: Triple = ALONG_Y
    force_n: float | None = None
