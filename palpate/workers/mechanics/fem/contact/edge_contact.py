r"""Contact of faces that reach behind the edge of a plate, at points inside them.

Nodes are further apart than the edge's radius: contact at nodes alone would be lost one node at
a time. A face that reaches behind the edge is therefore pressed at points inside it, the
centroids of equal parts, by the same penalty. Their energy replaces the energy of its
corners by a share that grows with the depths s of the corners behind the edge,

.. math:: E = \sum_a E_a + \sum_f \beta_f (E_f - \sum_{a \in f} E_{fa}) ,
    \quad \beta_f = 1 - \exp(-\sum_{a \in f} s_a^2 / l^2) ,

with the energies E_a of all nodes, E_f of the points of a face and E_fa of its part in its
corners. In front of the edge, and where the edge is at the end of the body, only nodes press.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.contact.contact_potential import (
    ContactNodes,
    ContactPotential,
    no_contact,
)
from palpate.workers.mechanics.fem.contact.plate_surface import Edge, PlateSurface, SurfaceGap

# Parts of each side of a face: 16 points. With 64 a body moves by less than 0.01 mm.
PARTS = 4
# The length l. With 2 mm the faces lose contact less smoothly, and Newton's method takes longer.
CHANGE_MM = 5.0


def _centroids() -> FloatArray:
    """Return the weights of the corners at the centroids of all parts of a face, (q, 3)."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(PARTS) for j in range(PARTS - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(PARTS) for j in range(PARTS - 1 - i)]
    second = np.array(upright + turned) / PARTS
    return np.column_stack([1 - second.sum(axis=1), second])


SHAPES = _centroids()
_PAIRS = (SHAPES[:, :, None] * SHAPES[:, None, :]).reshape(len(SHAPES), 9)


@dataclass(frozen=True, eq=False)
class PressedPoints:
    """Points of some faces that one plate may press, p per face.

    Parameters
    ----------
    stiffness : ndarray, shape (f, p)
        Area of each point times penalty, in N/mm.
    at : SurfaceGap
        Gap, shape (f, p), and its gradient, (f, p, 3).
    """

    stiffness: FloatArray
    at: SurfaceGap

    @cached_property
    def penetration(self) -> FloatArray:
        """Depth of each point inside the plate, shape (f, p) in mm."""
        return np.maximum(-self.at.gap, 0.0)

    @cached_property
    def load(self) -> FloatArray:
        """Normal force on each point, shape (f, p) in N."""
        return self.stiffness * self.penetration

    @cached_property
    def energy(self) -> FloatArray:
        """Energy of each face, shape (f,) in mJ."""
        return 0.5 * (self.load * self.penetration).sum(axis=1)

    @cached_property
    def pressed_stiffness(self) -> FloatArray:
        """Stiffness of the points that touch, shape (f, p) in N/mm."""
        return self.stiffness * (self.at.gap < 0)

    @cached_property
    def force(self) -> FloatArray:
        """Gradient of the energy in each point, shape (f, p, 3) in N."""
        return -self.load[:, :, None] * self.at.gradient

    def travel_force(self, velocity: FloatArray) -> FloatArray:
        """Return the derivative of each face's energy in the travel of the plate, (f,) in N."""
        return (self.load * (self.at.gradient @ velocity)).sum(axis=1)


@dataclass(frozen=True, eq=False)
class EdgeContact:
    """Faces that reach behind the edge of a plate and touch it.

    Parameters
    ----------
    nodes : ContactNodes
    surface : PlateSurface
    edge : Edge
        Of that plate.
    active : ndarray of int, shape (f,)
        Indices into `ContactNodes.faces`.
    corners : ndarray of int32, shape (f, 3)
        Indices into the contact nodes.
    behind : ndarray, shape (f, 3)
        Distance of each corner behind the edge, in mm.
    points, at_corners : PressedPoints
        The points inside the faces, and the parts of the corners.
    """

    nodes: ContactNodes
    surface: PlateSurface
    edge: Edge
    active: IntArray
    corners: IntArray
    behind: FloatArray
    points: PressedPoints
    at_corners: PressedPoints

    @cached_property
    def share(self) -> FloatArray:
        """Share of the corners' energy that the points replace, shape (f,)."""
        return 1 - np.exp(-((self.behind / CHANGE_MM) ** 2).sum(axis=1))

    @cached_property
    def share_slope(self) -> FloatArray:
        """Gradient of the share in each corner, shape (f, 3, 3) per mm."""
        slope = 2 * (1 - self.share)[:, None] * self.behind / CHANGE_MM**2
        return -slope[:, :, None] * self.edge.direction

    def taken_from_nodes(self) -> FloatArray:
        """Return the stiffness transferred from the nodes to the points, shape (c,) in N/mm."""
        return self._gathered(self.share[:, None] * self.at_corners.stiffness)

    def normal_force(self) -> FloatArray:
        """Return the normal force on the points, distributed to the nodes, shape (c,) in N."""
        return self._gathered(self.share[:, None] * (self.points.load @ SHAPES))

    def normal_force_change(self, moved: FloatArray, travel: float) -> FloatArray:
        """Return the change in the nodal normal forces due to the points, shape (c,) in N.

        Along a motion of the contact nodes, (c, 3), and a travel of the plates; it includes the
        stiffness taken from the nodes.
        """
        at, v = self.points.at, self.surface.velocity
        u = moved[self.corners]
        approach = travel * (at.gradient @ v) - (at.gradient * (SHAPES @ u)).sum(axis=2)
        change = self.share[:, None] * ((self.points.pressed_stiffness * approach) @ SHAPES)
        shifted = (self.share_slope * u).sum(axis=(1, 2))
        change += shifted[:, None] * (self.points.load @ SHAPES - self.at_corners.load)
        return self._gathered(change)

    def potential(self) -> ContactPotential:
        """Return the energy of the points and of the change of their share, without stiffness.

        The nodes keep the rest of their own energy; see `stiffness` for the second derivative.
        """
        surface, points = self.surface, self.points
        moving = points.at.gradient @ surface.velocity
        bend = surface.curvature @ surface.velocity
        k = points.pressed_stiffness
        force = np.einsum("fqi,qa->fai", points.force, SHAPES)
        coupling = -np.einsum("fq,fqi,qa->fai", k * moving, points.at.gradient, SHAPES)
        coupling -= (points.load @ SHAPES)[:, :, None] * bend
        by_travel = (k * moving**2).sum(axis=1) + points.load.sum(axis=1) * (
            bend @ surface.velocity
        )
        share = self.share[:, None, None]
        gained = self.points.energy - self.at_corners.energy
        return ContactPotential(
            energy=float(self.share @ points.energy),
            force=self._gathered(share * force + gained[:, None, None] * self.share_slope),
            stiffness=no_contact(self.nodes).stiffness,
            travel_force=float(self.share @ points.travel_force(surface.velocity)),
            coupling=self._gathered(share * coupling) + self.share_coupling,
            travel_stiffness=float(self.share @ by_travel),
        )

    @cached_property
    def share_coupling(self) -> FloatArray:
        """Coupling with the travel due to the change in the share, (c, 3) in N/mm.

        It belongs to the parts of the stiffness that may be negative.
        """
        v = self.surface.velocity
        gained = self.points.travel_force(v) - self.at_corners.travel_force(v)
        return self._gathered(gained[:, None, None] * self.share_slope)

    def stiffness(self, *, convex: bool) -> FloatArray:
        """Return the stiffness between the corners of each face, (f, 3, 3, 3, 3) in N/mm.

        The axes are face, two corners, and their directions. `convex` omits the parts that may be
        negative: the curvature of the rounding and the change in the share.
        """
        points, d = self.points, self.edge.direction
        g = points.at.gradient
        K = (points.pressed_stiffness[:, :, None] * g)[..., None] * g[:, :, None, :]
        K += points.load[:, :, None, None] * self.surface.curvature
        if not convex:
            K -= (points.load * points.at.rounding_per_mm)[:, :, None, None] * np.outer(d, d)
        K *= self.share[:, None, None, None]
        f = len(K)
        whole = (_PAIRS.T @ K.reshape(f, -1, 9)).reshape(f, 3, 3, 3, 3)
        return whole if convex else whole + self._stiffness_of_share()

    def _stiffness_of_share(self) -> FloatArray:
        """Return the stiffness due to the change in the share."""
        d, s = self.edge.direction, self.behind / CHANGE_MM
        change = np.einsum("fqi,qa->fai", self.points.force, SHAPES) - self.at_corners.force
        cross = self.share_slope[:, :, None, :, None] * change[:, None, :, None, :]
        curvature = 2 * (s > 0)[:, :, None] * np.eye(3) - 4 * s[:, :, None] * s[:, None, :]
        gained = self.points.energy - self.at_corners.energy
        curvature *= ((1 - self.share) * gained / CHANGE_MM**2)[:, None, None]
        return (
            cross + cross.transpose(0, 2, 1, 4, 3) + curvature[:, :, :, None, None] * np.outer(d, d)
        )

    def _gathered(self, of_corners: FloatArray) -> FloatArray:
        """Sum values of the corners of the faces, (f, 3) or (f, 3, 3), at the contact nodes."""
        c, index = len(self.nodes.index), self.corners.ravel()
        flat = of_corners.reshape(len(index), -1)
        sums = [np.bincount(index, column, c) for column in flat.T]
        return np.asarray(np.stack(sums, axis=1), np.float64).reshape(c, *of_corners.shape[2:])


def edge_contact(
    nodes: ContactNodes, surface: PlateSurface, here: FloatArray, at_nodes: SurfaceGap
) -> EdgeContact | None:
    """Find the faces that reach behind the edge of a plate.

    Parameters
    ----------
    nodes : ContactNodes
    surface : PlateSurface
    here : ndarray, shape (c, 3)
        Positions of the contact nodes, in mm.
    at_nodes : SurfaceGap
        Between them and the plate.

    Returns
    -------
    EdgeContact or None
        None if no such face touches the plate.
    """
    edge, corners = surface.edge, nodes.faces.corners
    if edge is None:
        return None
    behind = edge.behind(here)[corners]
    active = np.flatnonzero(behind.any(axis=1)).astype(np.int32)
    inside = surface.gap(SHAPES @ here[corners[active]])
    corners_touch = (at_nodes.gap[corners[active]] < 0).any(axis=1)
    touching: BoolArray = np.asarray((inside.gap < 0).any(axis=1) | corners_touch)
    if not touching.any():
        return None
    active = active[touching]
    corners, stiffness = corners[active], nodes.faces.stiffness[active, None]
    points = PressedPoints(
        np.repeat(stiffness / len(SHAPES), len(SHAPES), axis=1), inside[touching]
    )
    at_corners = PressedPoints(np.repeat(stiffness / 3, 3, axis=1), at_nodes[corners])
    return EdgeContact(nodes, surface, edge, active, corners, behind[active], points, at_corners)
