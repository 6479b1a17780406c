r"""Surfaces of two rigid plates, the gap between them and the body, and the energy of contact.

A plate needs no contact search: it is a plane, or a paraboloid close to one, and
the gap of a point is

.. math:: g(x) = n \cdot r - \tfrac12 r^T C r , \quad r = x - p - t v ,

with the normal n into the body, a point p, the velocity v per travel t and the
curvature C. A plate with an edge leaves the body behind it as a parabola of the radius R of
its rounding: at a distance s behind the edge the gap is larger by s^2 / 2R.

`ContactNodes` and `ContactFaces` may touch a plate; a `ContactPotential` is the contact energy with
its derivatives.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.loads_and_regions import Device, Plate

EDGE_RADIUS_MM = 2.0


@dataclass(frozen=True, slots=True)
class Gap:
    """Positions of the plates along the axis, in mm: the body is in between."""

    lower_mm: float
    upper_mm: float

    def closed_by(self, distance_mm: float, lower_share: float = 0.0) -> "Gap":
        """Return the gap after moving the plates towards each other by `distance_mm`."""
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
    """Start of the flat part of a plate: direction into it, (3,), and distance along it, in mm."""

    direction: FloatArray
    start_mm: float

    def behind(self, x: FloatArray) -> FloatArray:
        """Return the depth of points, (..., 3), behind the edge, (...) in mm; zero in front."""
        return np.maximum(self.start_mm - x @ self.direction, 0.0)


@dataclass(frozen=True, eq=False)
class SurfaceGap:
    """Gap between points and a plate, and its derivatives.

    Parameters
    ----------
    gap : ndarray, shape (...)
        In mm, negative inside the plate.
    gradient : ndarray, shape (..., 3)
    rounding_per_mm : ndarray, shape (...)
        Curvature of the rounded edge; zero in front of it.
    """

    gap: FloatArray
    gradient: FloatArray
    rounding_per_mm: FloatArray

    def __getitem__(self, some: BoolArray | IntArray) -> "SurfaceGap":
        return SurfaceGap(self.gap[some], self.gradient[some], self.rounding_per_mm[some])


@dataclass(frozen=True, eq=False)
class PlateSurface:
    """One plate at its present position: point, inward normal, velocity, curvature (3, 3)."""

    point: FloatArray
    normal: FloatArray
    velocity: FloatArray
    curvature: FloatArray
    edge: Edge | None = None

    def gap(self, x: FloatArray) -> SurfaceGap:
        """Return the gap between points, (..., 3) in mm, and this plate."""
        r = x - self.point
        bent = r @ self.curvature
        gap = r @ self.normal - 0.5 * (r * bent).sum(axis=-1)
        gradient = self.normal - bent
        if self.edge is None:
            return SurfaceGap(gap, gradient, np.zeros_like(gap))
        behind = self.edge.behind(x)
        return SurfaceGap(
            gap=gap + 0.5 * behind**2 / EDGE_RADIUS_MM,
            gradient=gradient - (behind / EDGE_RADIUS_MM)[..., None] * self.edge.direction,
            rounding_per_mm=(behind > 0) / EDGE_RADIUS_MM,
        )


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
    """Tilt and bend a plane through `point`; `plane`, (2, 3), holds its in-plane axes."""
    rotation = np.eye(3)
    for about, degrees in zip(plane, plate.tilt_deg, strict=True):
        rotation = _rotation(about, np.radians(degrees)) @ rotation
    in_plane = plane @ rotation.T
    # Where a plate bends away, the gap grows with the distance from the pivot.
    curvature = -sum(b * np.outer(a, a) for a, b in zip(in_plane, plate.bow_per_mm, strict=True))
    return PlateSurface(point, rotation @ normal, velocity, np.asarray(curvature), edge)


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation matrix about a unit `axis` by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


@dataclass(frozen=True, eq=False)
class ContactFaces:
    """Triangles between the contact nodes.

    Parameters
    ----------
    corners : ndarray of int32, shape (f, 3)
        Indices into the contact nodes.
    stiffness : ndarray, shape (f,)
        Area times penalty, in N/mm.
    """

    corners: IntArray
    stiffness: FloatArray


NO_FACES = ContactFaces(np.zeros((0, 3), np.int32), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ContactNodes:
    """Nodes that may touch a plate.

    Parameters
    ----------
    index : ndarray of int32, shape (c,)
        Their numbers in the mesh.
    stiffness : ndarray, shape (c,)
        Nodal area times penalty, in N/mm.
    faces : ContactFaces
        Without faces, an edge acts at the nodes alone.
    """

    index: IntArray
    stiffness: FloatArray
    faces: ContactFaces = NO_FACES


@dataclass(frozen=True, eq=False)
class ContactPotential:
    """Energy E(x, t) of the contact nodes and the travel t, with its derivatives.

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
        Mixed second derivative with respect to x and t, in N/mm.
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
