r"""Two rigid plates, by a penalty on nodal areas.

A plate needs no contact search: it is a plane, or a paraboloid close to one, and
the gap of a node is

.. math:: g(x) = n \cdot r - \tfrac12 r^T C r , \quad r = x - p - t v ,

with the normal n into the body, a point p, the velocity v per travel t and the
curvature C. The penalty lets the body into the plate by pressure / 0.5 N/mm^3,
which is 0.04 mm at a mean pressure of 20 kPa.
"""

from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray, IntArray
from workers.fem.loads import Device, Plate

PENALTY_N_PER_MM3 = 0.5


@dataclass(frozen=True, eq=False)
class Pads:
    """The nodes that may touch, shape (c,), and their stiffness, area x penalty, in N/mm."""

    nodes: IntArray
    stiffness: FloatArray


@dataclass(frozen=True, slots=True)
class Gap:
    """Where the plates stand along the axis: the body fits in between."""

    lower_mm: float
    upper_mm: float

    def closed_by(self, distance_mm: float, lower_share: float = 0.0) -> "Gap":
        """The plates moved towards each other by `distance_mm`."""
        return Gap(
            self.lower_mm + lower_share * distance_mm,
            self.upper_mm - (1 - lower_share) * distance_mm,
        )

    def towards(self, other: "Gap", fraction: float) -> "Gap":
        """Between this gap (0) and another (1)."""
        return Gap(
            self.lower_mm + fraction * (other.lower_mm - self.lower_mm),
            self.upper_mm + fraction * (other.upper_mm - self.upper_mm),
        )


@dataclass(frozen=True, eq=False)
class Surface:
    """One plate where it stands: point, normal into the body, velocity, curvature (3, 3)."""

    point: FloatArray
    normal: FloatArray
    velocity: FloatArray
    curvature: FloatArray


def surfaces(device: Device, gap: Gap) -> tuple[Surface, Surface]:
    """The lower and the upper plate of `device` at `gap`."""
    axis = np.asarray(device.axis) / np.linalg.norm(device.axis)
    second = np.array([0.0, 0.0, 1.0])
    second = second - (second @ axis) * axis
    second /= np.linalg.norm(second)
    plane = np.stack([np.cross(axis, second), second])
    pivot = np.asarray(device.pivot_mm)
    pivot = pivot - (pivot @ axis) * axis
    share = device.lower_share
    return (
        _surface(device.lower, pivot + gap.lower_mm * axis, axis, share * axis, plane),
        _surface(device.upper, pivot + gap.upper_mm * axis, -axis, (share - 1) * axis, plane),
    )


def _surface(
    plate: Plate, point: FloatArray, normal: FloatArray, velocity: FloatArray, plane: FloatArray
) -> Surface:
    turn = np.eye(3)
    for about, degrees in zip(plane, plate.tilt_deg, strict=True):
        turn = _rotation(about, np.radians(degrees)) @ turn
    across = plane @ turn.T
    # A plate that bends away leaves room: the gap grows with the distance from the pivot.
    curvature = -sum(b * np.outer(a, a) for a, b in zip(across, plate.bow_per_mm, strict=True))
    return Surface(point, turn @ normal, velocity, np.asarray(curvature))


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Rodrigues' formula for a unit `axis`."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


@dataclass(frozen=True, eq=False)
class Press:
    """Gap between each pad and one plate, (c,) in mm, and its gradient, (c, 3)."""

    pads: Pads
    surface: Surface
    gap: FloatArray
    gradient: FloatArray

    @property
    def depth(self) -> FloatArray:
        """How far each pad is inside the plate, shape (c,) in mm."""
        return np.maximum(-self.gap, 0.0)

    @property
    def load(self) -> FloatArray:
        """Normal force on each pad in N, shape (c,)."""
        return self.pads.stiffness * self.depth


@dataclass(frozen=True, eq=False)
class Bordered:
    """An energy E(x, t) of the pads and the travel, with its derivatives.

    Parameters
    ----------
    energy : float
        mJ.
    force : ndarray, shape (c, 3)
        dE/dx of each pad, in N.
    stiffness : ndarray, shape (c, 3, 3)
        N/mm.
    travel_force : float
        dE/dt, the force that closes the plates, in N.
    coupling : ndarray, shape (c, 3)
        Second derivative by x and t, in N/mm.
    travel_stiffness : float
    """

    energy: float
    force: FloatArray
    stiffness: FloatArray
    travel_force: float
    coupling: FloatArray
    travel_stiffness: float

    def __add__(self, other: "Bordered") -> "Bordered":
        return Bordered(
            self.energy + other.energy,
            self.force + other.force,
            self.stiffness + other.stiffness,
            self.travel_force + other.travel_force,
            self.coupling + other.coupling,
            self.travel_stiffness + other.travel_stiffness,
        )


def nothing(pads: Pads) -> Bordered:
    """No energy at all."""
    c = len(pads.nodes)
    return Bordered(0.0, np.zeros((c, 3)), np.zeros((c, 3, 3)), 0.0, np.zeros((c, 3)), 0.0)


def press(pads: Pads, x: FloatArray, plate: Surface) -> Press:
    """The pads of `x`, shape (n, 3), against one plate."""
    r = x[pads.nodes] - plate.point
    bent = r @ plate.curvature
    gap = r @ plate.normal - 0.5 * (r * bent).sum(axis=1)
    return Press(pads, plate, gap, plate.normal - bent)


def normal_contact(p: Press) -> Bordered:
    """The penalty energy of one plate and its derivatives."""
    s, g, load = p.surface, p.gradient, p.load
    k = p.pads.stiffness * (p.gap < 0)
    moving = g @ s.velocity
    bend = s.curvature @ s.velocity
    return Bordered(
        energy=0.5 * float(load @ p.depth),
        force=-load[:, None] * g,
        stiffness=k[:, None, None] * g[:, :, None] * g[:, None, :]
        + load[:, None, None] * s.curvature,
        travel_force=float(load @ moving),
        coupling=-(k * moving)[:, None] * g - load[:, None] * bend,
        travel_stiffness=float(k @ moving**2 + load.sum() * (bend @ s.velocity)),
    )
