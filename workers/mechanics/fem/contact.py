r"""Contact with two rigid plates, by a penalty on nodal areas.

A plate needs no contact search: it is a plane, or a paraboloid close to one, and
the gap of a node is

.. math:: g(x) = n \cdot r - \tfrac12 r^T C r , \quad r = x - p - t v ,

with the normal n into the body, a point p, the velocity v per travel t and the
curvature C. A plate with an edge leaves the body behind it as a parabola of the radius R of
its rounding: at a distance s behind the edge the gap is larger by s^2 / 2R. The penalty lets
the body into the plate by pressure / 0.5 N/mm^3, which is 0.04 mm at a mean pressure of 20 kPa.
"""

from dataclasses import dataclass, replace

import numpy as np

from storage.values import BoolArray, FloatArray, IntArray
from workers.mechanics.fem.loads import Device, Plate

PENALTY_N_PER_MM3 = 0.5
# An opened blind body between such plates has 8 nats less with 10 mm.
EDGE_RADIUS_MM = 5.0


@dataclass(frozen=True, eq=False)
class ContactNodes:
    """The nodes that may touch a plate.

    Parameters
    ----------
    index : ndarray of int32, shape (c,)
        Their numbers in the mesh.
    stiffness : ndarray, shape (c,)
        Nodal area times penalty, in N/mm.
    """

    index: IntArray
    stiffness: FloatArray


@dataclass(frozen=True, slots=True)
class Gap:
    """Positions of the plates along the axis, in mm: the body fits in between."""

    lower_mm: float
    upper_mm: float

    def closed_by(self, distance_mm: float, lower_share: float = 0.0) -> "Gap":
        """Return the gap after the plates moved towards each other by `distance_mm`."""
        return Gap(
            self.lower_mm + lower_share * distance_mm,
            self.upper_mm - (1 - lower_share) * distance_mm,
        )

    def towards(self, other: "Gap", fraction: float) -> "Gap":
        """Interpolate between this gap (0) and another (1)."""
        return Gap(
            self.lower_mm + fraction * (other.lower_mm - self.lower_mm),
            self.upper_mm + fraction * (other.upper_mm - self.upper_mm),
        )


@dataclass(frozen=True, eq=False)
class Edge:
    """Where a plate begins: the direction into the plate, (3,), and how far along it, in mm."""

    direction: FloatArray
    start_mm: float

    def behind(self, x: FloatArray) -> FloatArray:
        """Return how far points, shape (c, 3), lie behind the edge, (c,) in mm; zero before it."""
        return np.maximum(self.start_mm - x @ self.direction, 0.0)


@dataclass(frozen=True, eq=False)
class PlateSurface:
    """One plate where it stands: point, normal into the body, velocity, curvature (3, 3)."""

    point: FloatArray
    normal: FloatArray
    velocity: FloatArray
    curvature: FloatArray
    edge: Edge | None = None


def plate_surfaces(device: Device, gap: Gap) -> tuple[PlateSurface, PlateSurface]:
    """Return the lower and the upper plate of `device` at `gap`."""
    axis = np.asarray(device.axis) / np.linalg.norm(device.axis)
    second = np.array([0.0, 0.0, 1.0])
    second = second - (second @ axis) * axis
    second /= np.linalg.norm(second)
    plane = np.stack([np.cross(axis, second), second])
    pivot = np.asarray(device.pivot_mm)
    pivot = pivot - (pivot @ axis) * axis
    share = device.lower_share
    edge = None if device.edge_mm is None else Edge(second, device.edge_mm)
    return (
        _surface(device.lower, pivot + gap.lower_mm * axis, axis, share * axis, plane, edge),
        _surface(device.upper, pivot + gap.upper_mm * axis, -axis, (share - 1) * axis, plane, edge),
    )


def _surface(
    plate: Plate,
    point: FloatArray,
    normal: FloatArray,
    velocity: FloatArray,
    plane: FloatArray,
    edge: Edge | None,
) -> PlateSurface:
    """Tilt and bend a plane through `point`; `plane`, (2, 3), are its in-plane axes."""
    rotation = np.eye(3)
    for about, degrees in zip(plane, plate.tilt_deg, strict=True):
        rotation = _rotation(about, np.radians(degrees)) @ rotation
    in_plane = plane @ rotation.T
    # A plate that bends away leaves room: the gap grows with the distance from the pivot.
    curvature = -sum(b * np.outer(a, a) for a, b in zip(in_plane, plate.bow_per_mm, strict=True))
    return PlateSurface(point, rotation @ normal, velocity, np.asarray(curvature), edge)


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation matrix about a unit `axis` by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


@dataclass(frozen=True, eq=False)
class PlateContact:
    """Gap between each contact node and one plate, (c,) in mm, and its gradient, (c, 3).

    Of a plate with an edge, `behind` are the nodes that lie behind it, shape (c,).
    """

    nodes: ContactNodes
    surface: PlateSurface
    gap: FloatArray
    gradient: FloatArray
    behind: BoolArray | None = None

    @property
    def penetration(self) -> FloatArray:
        """Depth of each contact node inside the plate, shape (c,) in mm."""
        return np.maximum(-self.gap, 0.0)

    @property
    def normal_force(self) -> FloatArray:
        """Normal force on each contact node in N, shape (c,)."""
        return self.nodes.stiffness * self.penetration


@dataclass(frozen=True, eq=False)
class ContactPotential:
    """An energy E(x, t) of the contact nodes and the travel t, with its derivatives.

    Parameters
    ----------
    energy : float
        mJ.
    force : ndarray, shape (c, 3)
        dE/dx of each contact node, in N.
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

    def __add__(self, other: "ContactPotential") -> "ContactPotential":
        return ContactPotential(
            self.energy + other.energy,
            self.force + other.force,
            self.stiffness + other.stiffness,
            self.travel_force + other.travel_force,
            self.coupling + other.coupling,
            self.travel_stiffness + other.travel_stiffness,
        )


def no_contact(nodes: ContactNodes) -> ContactPotential:
    """Return a potential that is zero."""
    c = len(nodes.index)
    return ContactPotential(0.0, np.zeros((c, 3)), np.zeros((c, 3, 3)), 0.0, np.zeros((c, 3)), 0.0)


def plate_contact(nodes: ContactNodes, x: FloatArray, plate: PlateSurface) -> PlateContact:
    """Measure the gap between the contact nodes of `x`, shape (n, 3) in mm, and one plate."""
    r = x[nodes.index] - plate.point
    bent = r @ plate.curvature
    gap = r @ plate.normal - 0.5 * (r * bent).sum(axis=1)
    contact = PlateContact(nodes, plate, gap, plate.normal - bent)
    return contact if plate.edge is None else _with_edge(contact, x, plate.edge)


def _with_edge(contact: PlateContact, x: FloatArray, edge: Edge) -> PlateContact:
    behind = edge.behind(x[contact.nodes.index])
    return replace(
        contact,
        gap=contact.gap + 0.5 * behind**2 / EDGE_RADIUS_MM,
        gradient=contact.gradient - (behind / EDGE_RADIUS_MM)[:, None] * edge.direction,
        behind=behind > 0,
    )


def penalty_potential(contact: PlateContact) -> ContactPotential:
    """Return the penalty energy of one plate and its derivatives."""
    s, g, load = contact.surface, contact.gradient, contact.normal_force
    k = contact.nodes.stiffness * (contact.gap < 0)
    moving = g @ s.velocity
    bend = s.curvature @ s.velocity
    stiffness = k[:, None, None] * g[:, :, None] * g[:, None, :]
    stiffness += load[:, None, None] * s.curvature
    if s.edge is not None:
        stiffness += edge_stiffness(contact)
    return ContactPotential(
        energy=0.5 * float(load @ contact.penetration),
        force=-load[:, None] * g,
        stiffness=stiffness,
        travel_force=float(load @ moving),
        coupling=-(k * moving)[:, None] * g - load[:, None] * bend,
        travel_stiffness=float(k @ moving**2 + load.sum() * (bend @ s.velocity)),
    )


def edge_stiffness(contact: PlateContact) -> FloatArray:
    """Return what the rounding of an edge adds to the stiffness, shape (c, 3, 3) in N/mm.

    It is negative: a node that slides off the edge is pushed on. The plates move along their
    axis, so the edge stays where it is.
    """
    edge = contact.surface.edge
    if edge is None or contact.behind is None:
        raise ValueError("the plate has no edge")
    rounding = contact.normal_force * contact.behind / EDGE_RADIUS_MM
    return -rounding[:, None, None] * np.outer(edge.direction, edge.direction)
