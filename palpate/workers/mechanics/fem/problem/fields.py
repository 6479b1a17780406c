"""Fields inside a body: fibre directions, gradients of stiffness, inclusions."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Tissue, Triple


@dataclass(frozen=True, slots=True)
class Frame:
    """Box around the undeformed body; its faces have the coordinates -1 and 1."""

    centre_mm: Triple = (0.0, 0.0, 0.0)
    half_mm: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not min(self.half_mm) > 0:
            raise InputError(f"A frame needs a size along x, y and z, got {self.half_mm} mm.")

    def normalised(self, points: FloatArray) -> FloatArray:
        """Return `points`, shape (k, 3) in mm, in units of the box."""
        return np.asarray((points - np.asarray(self.centre_mm)) / np.asarray(self.half_mm))


def frame_of(nodes: FloatArray) -> Frame:
    """Return the frame of the body with these `nodes`, shape (n, 3) in mm."""
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    return Frame(_triple((low + high) / 2), _triple((high - low) / 2))


def _triple(values: FloatArray) -> Triple:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True, slots=True)
class FibreField:
    """Directions of the fibres in the undeformed body.

    At normalised coordinates (a, b) along x and y the fibre is `axis`, turned by
    ``turn_deg[1] + fan_deg[1] b`` towards y and by ``turn_deg[0] + fan_deg[0] a``
    towards x.

    Parameters
    ----------
    axis : tuple of float
        From chest wall to nipple.
    turn_deg, fan_deg : tuple of float
        Towards x and towards y.
    second_axis : tuple of float
        Direction of the second family, if constants give it a stiffness.
    frame : Frame
    """

    axis: Triple = (0.0, 0.0, 1.0)
    turn_deg: tuple[float, float] = (0.0, 0.0)
    fan_deg: tuple[float, float] = (0.0, 0.0)
    second_axis: Triple = (0.0, 1.0, 0.0)
    frame: Frame = Frame()

    def __post_init__(self) -> None:
        for direction in (self.axis, self.second_axis):
            if not np.linalg.norm(direction) > 0:
                raise InputError(f"The fibre direction must not be zero, got {direction}.")

    def directions(self, points: FloatArray) -> FloatArray:
        """Return unit vectors of the first family at `points`, shape (k, 3)."""
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        directions = np.tile(axis, (len(points), 1))
        if any(self.turn_deg) or any(self.fan_deg):
            place = self.frame.normalised(points)
            for k in range(2):
                angle = np.radians(self.turn_deg[k] + self.fan_deg[k] * place[:, k])
                directions[:, k] += np.tan(angle)
            directions /= np.linalg.norm(directions, axis=1)[:, None]
        return directions

    def second_directions(self, points: FloatArray) -> FloatArray:
        """Return unit vectors of the second family at `points`, shape (k, 3)."""
        return np.tile(
            np.asarray(self.second_axis) / np.linalg.norm(self.second_axis), (len(points), 1)
        )


WALL_TO_NIPPLE = FibreField()


@dataclass(frozen=True, slots=True)
class Gradient:
    """Exponential gradient of the stiffness: ln of the factor from the centre to each face.

    Parameters
    ----------
    log_per_half : tuple of float
        Along x, y and z.
    frame : Frame
    tissues : tuple of Tissue
        Tissues it applies to; empty means all.
    """

    log_per_half: Triple
    frame: Frame
    tissues: tuple[Tissue, ...] = ()

    def log_factor(self, points: FloatArray) -> FloatArray:
        """Return ln of the factor at `points`, shape (k, 3)."""
        return np.asarray(self.frame.normalised(points) @ np.asarray(self.log_per_half))


# An inclusion fades over this length, so that its position and size have derivatives.
EDGE_MM = 1.0
# Beyond so many of these lengths from its surface it has no effect: tanh is 1 to the last digit.
GONE_AFTER = 20.0


@dataclass(frozen=True, slots=True)
class Inclusion:
    """Ball in which the stiffness of every tissue is multiplied by exp(`log_ratio`)."""

    log_ratio: float
    centre_mm: Triple
    radius_mm: float
    tissues: tuple[Tissue, ...] = ()

    def __post_init__(self) -> None:
        if not self.radius_mm > 0:
            raise InputError(f"An inclusion needs a radius > 0, got {self.radius_mm:g} mm.")

    def log_factor(self, points: FloatArray) -> FloatArray:
        """Return ln of the factor at `points`, shape (k, 3)."""
        away = np.linalg.norm(points - np.asarray(self.centre_mm), axis=1) - self.radius_mm
        return np.asarray(self.log_ratio * 0.5 * (1 - np.tanh(away / EDGE_MM)))

    def reaches(self, nodes: FloatArray) -> BoolArray:
        """Test whether its factor at each of `nodes`, shape (n, 3), may differ from 1."""
        away = nodes - np.asarray(self.centre_mm)
        reach = self.radius_mm + GONE_AFTER * EDGE_MM
        return np.asarray(np.einsum("ij,ij->i", away, away) < reach**2)


Variation = Gradient | Inclusion


def stiffness_factors(
    variations: Iterable[Variation], nodes: FloatArray, tets: IntArray, n_tissues: int
) -> FloatArray:
    """Return the stiffness factor of each tissue in each element, shape (m, tissues).

    The logarithm is averaged over the corners and the centroid of the element.
    """
    log = np.zeros((len(tets), n_tissues))
    centroids = _mean_of_corners(nodes, tets)
    for variation in variations:
        of = [int(t) for t in variation.tissues] or list(range(n_tissues))
        at_corners = _mean_of_corners(variation.log_factor(nodes), tets)
        log[:, of] += (0.8 * at_corners + 0.2 * variation.log_factor(centroids))[:, None]
    return np.exp(log)


def elements_reached(
    inclusions: Iterable[Inclusion], nodes: FloatArray, tets: IntArray, centroids: FloatArray
) -> BoolArray:
    """Find the elements in which inclusions may change the stiffness, shape (m,)."""
    corners, middles = np.zeros(len(nodes), np.bool_), np.zeros(len(tets), np.bool_)
    for ball in inclusions:
        corners |= ball.reaches(nodes)
        middles |= ball.reaches(centroids)  # for elements larger than the ball
    for corner in tets.T:
        middles |= corners[corner]
    return middles


def _mean_of_corners(values: FloatArray, tets: IntArray) -> FloatArray:
    """Average nodal values, (n, ...), over the corners of each element, (m, ...)."""
    a, b, c, d = tets.T
    return np.asarray((values[a] + values[b] + values[c] + values[d]) / 4)
