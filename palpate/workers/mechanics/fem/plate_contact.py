r"""Contact with two rigid plates: a penalty on nodal areas, plate edges, Coulomb friction.

The body penetrates the plate by pressure / 0.5 N/mm^3, which is 0.04 mm at a mean pressure of
20 kPa.

Nodes are further apart than the edge's radius: contact at nodes alone would be lost one node at
a time. A face that reaches behind the edge of a plate is therefore pressed at points inside it, the
centroids of equal parts, by the same penalty. Their energy replaces the energy of its
corners by a share that grows with the depths s of the corners behind the edge,

.. math:: E = \sum_a E_a + \sum_f \beta_f (E_f - \sum_{a \in f} E_{fa}) ,
    \quad \beta_f = 1 - \exp(-\sum_{a \in f} s_a^2 / l^2) ,

with the energies E_a of all nodes, E_f of the points of a face and E_fa of its part in its
corners. In front of the edge, and where the edge is at the end of the body, only nodes press.

Friction is applied in load steps. Within one step a contact node that carries the normal force
lambda and slips by s against its plate dissipates

.. math:: D = \mu \lambda (\sqrt{s^2 + \epsilon^2} - \epsilon) ,

which is Coulomb's law except for slips of the order of epsilon, over which friction
builds up (a regularised pseudo-potential). Slip is measured from an origin: the node's
position when it began to slip, dragged along behind it from step to step, so that a
sticking node does not creep. lambda is the force of the present state: every step ends
in implicit Coulomb equilibrium. Its derivative is in
`workers.mechanics.fem.level_equilibrium`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.mechanics.fem.plate_surface import (
    ContactNodes,
    ContactPotential,
    Edge,
    PlateSurface,
    SurfaceGap,
    no_contact,
)

# Parts of each side of a face: 16 points. With 64 a body moves by less than 0.01 mm.
PARTS_OF_FACE = 4
# The length l. With 2 mm the faces lose contact less smoothly, and Newton's method takes longer.
EDGE_CHANGE_MM = 5.0


def _centroids() -> FloatArray:
    """Return the weights of the corners at the centroids of all parts of a face, (q, 3)."""
    upright = [
        (i + 1 / 3, j + 1 / 3) for i in range(PARTS_OF_FACE) for j in range(PARTS_OF_FACE - i)
    ]
    turned = [
        (i + 2 / 3, j + 2 / 3) for i in range(PARTS_OF_FACE) for j in range(PARTS_OF_FACE - 1 - i)
    ]
    second = np.array(upright + turned) / PARTS_OF_FACE
    return np.column_stack([1 - second.sum(axis=1), second])


PART_SHAPES = _centroids()
_CORNER_PAIRS = (PART_SHAPES[:, :, None] * PART_SHAPES[:, None, :]).reshape(len(PART_SHAPES), 9)


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
        return 1 - np.exp(-((self.behind / EDGE_CHANGE_MM) ** 2).sum(axis=1))

    @cached_property
    def share_slope(self) -> FloatArray:
        """Gradient of the share in each corner, shape (f, 3, 3) per mm."""
        slope = 2 * (1 - self.share)[:, None] * self.behind / EDGE_CHANGE_MM**2
        return -slope[:, :, None] * self.edge.direction

    def taken_from_nodes(self) -> FloatArray:
        """Return the stiffness transferred from the nodes to the points, shape (c,) in N/mm."""
        return self._gathered(self.share[:, None] * self.at_corners.stiffness)

    def normal_force(self) -> FloatArray:
        """Return the normal force on the points, distributed to the nodes, shape (c,) in N."""
        return self._gathered(self.share[:, None] * (self.points.load @ PART_SHAPES))

    def normal_force_change(self, moved: FloatArray, travel: float) -> FloatArray:
        """Return the change in the nodal normal forces due to the points, shape (c,) in N.

        Along a motion of the contact nodes, (c, 3), and a travel of the plates; it includes the
        stiffness taken from the nodes.
        """
        at, v = self.points.at, self.surface.velocity
        u = moved[self.corners]
        approach = travel * (at.gradient @ v) - (at.gradient * (PART_SHAPES @ u)).sum(axis=2)
        change = self.share[:, None] * ((self.points.pressed_stiffness * approach) @ PART_SHAPES)
        shifted = (self.share_slope * u).sum(axis=(1, 2))
        change += shifted[:, None] * (self.points.load @ PART_SHAPES - self.at_corners.load)
        return self._gathered(change)

    def potential(self) -> ContactPotential:
        """Return the energy of the points and of the change of their share, without stiffness.

        The nodes keep the rest of their own energy; see `stiffness` for the second derivative.
        """
        surface, points = self.surface, self.points
        moving = points.at.gradient @ surface.velocity
        bend = surface.curvature @ surface.velocity
        k = points.pressed_stiffness
        force = np.einsum("fqi,qa->fai", points.force, PART_SHAPES)
        coupling = -np.einsum("fq,fqi,qa->fai", k * moving, points.at.gradient, PART_SHAPES)
        coupling -= (points.load @ PART_SHAPES)[:, :, None] * bend
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
        whole = (_CORNER_PAIRS.T @ K.reshape(f, -1, 9)).reshape(f, 3, 3, 3, 3)
        return whole if convex else whole + self._stiffness_of_share()

    def _stiffness_of_share(self) -> FloatArray:
        """Return the stiffness due to the change in the share."""
        d, s = self.edge.direction, self.behind / EDGE_CHANGE_MM
        change = np.einsum("fqi,qa->fai", self.points.force, PART_SHAPES) - self.at_corners.force
        cross = self.share_slope[:, :, None, :, None] * change[:, None, :, None, :]
        curvature = 2 * (s > 0)[:, :, None] * np.eye(3) - 4 * s[:, :, None] * s[:, None, :]
        gained = self.points.energy - self.at_corners.energy
        curvature *= ((1 - self.share) * gained / EDGE_CHANGE_MM**2)[:, None, None]
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
    inside = surface.gap(PART_SHAPES @ here[corners[active]])
    corners_touch = (at_nodes.gap[corners[active]] < 0).any(axis=1)
    touching: BoolArray = np.asarray((inside.gap < 0).any(axis=1) | corners_touch)
    if not touching.any():
        return None
    active = active[touching]
    corners, stiffness = corners[active], nodes.faces.stiffness[active, None]
    points = PressedPoints(
        np.repeat(stiffness / len(PART_SHAPES), len(PART_SHAPES), axis=1), inside[touching]
    )
    at_corners = PressedPoints(np.repeat(stiffness / 3, 3, axis=1), at_nodes[corners])
    return EdgeContact(nodes, surface, edge, active, corners, behind[active], points, at_corners)


PENALTY_N_PER_MM3 = 0.5


@dataclass(frozen=True, eq=False)
class PlateContact:
    """Gap between the contact nodes and one plate.

    Parameters
    ----------
    nodes : ContactNodes
    surface : PlateSurface
    at_nodes : SurfaceGap
        Gap of each node, (c,) in mm, and its gradient, (c, 3).
    at_edge : EdgeContact or None
        Faces that reach behind the edge of the plate.
    """

    nodes: ContactNodes
    surface: PlateSurface
    at_nodes: SurfaceGap
    at_edge: EdgeContact | None = None

    @property
    def gap(self) -> FloatArray:
        """Gap of each contact node, shape (c,) in mm."""
        return self.at_nodes.gap

    @property
    def penetration(self) -> FloatArray:
        """Depth of each contact node inside the plate, shape (c,) in mm."""
        return np.maximum(-self.gap, 0.0)

    @cached_property
    def stiffness(self) -> FloatArray:
        """Stiffness of each contact node, less the points' share, shape (c,) in N/mm."""
        whole = self.nodes.stiffness
        return whole if self.at_edge is None else whole - self.at_edge.taken_from_nodes()

    @property
    def nodal_load(self) -> FloatArray:
        """Normal force on each contact node without points of faces, (c,) in N."""
        return self.stiffness * self.penetration

    @property
    def normal_force(self) -> FloatArray:
        """Normal force on each contact node in N, shape (c,)."""
        if self.at_edge is None:
            return self.nodal_load
        return self.nodal_load + self.at_edge.normal_force()

    def normal_force_change(self, moved: FloatArray, travel: float) -> FloatArray:
        """Return the change in the normal force, shape (c,) in N.

        Along a motion of the contact nodes, (c, 3), and a travel of the plates.
        """
        gradient = self.at_nodes.gradient
        approach = travel * (gradient @ self.surface.velocity)
        approach = approach - (gradient * moved).sum(axis=1)
        change = self.stiffness * (self.gap < 0) * approach
        if self.at_edge is None:
            return change
        return change + self.at_edge.normal_force_change(moved, travel)


def plate_contact(nodes: ContactNodes, x: FloatArray, plate: PlateSurface) -> PlateContact:
    """Return the gap between the contact nodes of `x`, shape (n, 3) in mm, and one plate."""
    here = x[nodes.index]
    at_nodes = plate.gap(here)
    at_edge = None if plate.edge is None else edge_contact(nodes, plate, here, at_nodes)
    return PlateContact(nodes, plate, at_nodes, at_edge)


def penalty_potential(contact: PlateContact) -> ContactPotential:
    """Return the penalty energy of one plate and its derivatives.

    The stiffness of faces at an edge couples their corners and is not included; see
    `EdgeContact.stiffness`.
    """
    s, g, load = contact.surface, contact.at_nodes.gradient, contact.nodal_load
    k = contact.stiffness * (contact.gap < 0)
    moving = g @ s.velocity
    bend = s.curvature @ s.velocity
    stiffness = k[:, None, None] * g[:, :, None] * g[:, None, :]
    stiffness += load[:, None, None] * s.curvature
    if s.edge is not None:
        stiffness += edge_stiffness(contact)
    at_nodes = ContactPotential(
        energy=0.5 * float(load @ contact.penetration),
        force=-load[:, None] * g,
        stiffness=stiffness,
        travel_force=float(load @ moving),
        coupling=-(k * moving)[:, None] * g - load[:, None] * bend,
        travel_stiffness=float(k @ moving**2 + load.sum() * (bend @ s.velocity)),
    )
    return at_nodes if contact.at_edge is None else at_nodes + contact.at_edge.potential()


def edge_stiffness(contact: PlateContact) -> FloatArray:
    """Return the nodal stiffness due to the rounding of an edge, (c, 3, 3) in N/mm.

    It is negative: a node that slides off the edge is pushed further. The plates move along their
    axis, so the edge does not move within its plane.
    """
    edge = contact.surface.edge
    if edge is None:
        raise ValueError("the plate has no edge")
    rounding = contact.nodal_load * contact.at_nodes.rounding_per_mm
    return -rounding[:, None, None] * np.outer(edge.direction, edge.direction)


# Friction is half built up after 0.6 epsilon.
SLIP_EPSILON_MM = 0.05
# Slip that a sliding node keeps when it reverses; friction is then at 95 %.
CONTACT_RESERVE_MM = 3 * SLIP_EPSILON_MM


@dataclass(frozen=True, eq=False)
class PlateFriction:
    """Friction of one plate during one load step.

    Parameters
    ----------
    nodes : ContactNodes
    plate : PlateSurface
    coefficient : float
        Coulomb's mu.
    slip_origin : ndarray, shape (c, 3)
        Origin of the slip of each contact node, in mm.
    start_travel_mm : float
        Travel of the plates at the beginning of the step.
    normal_force : ndarray, shape (c,)
        lambda of each contact node, in N.
    dual : ndarray, shape (c, 3), optional
        Direction of friction where it is a separate unknown; see `coupled_newton`.
    """

    nodes: ContactNodes
    plate: PlateSurface
    coefficient: float
    slip_origin: FloatArray
    start_travel_mm: float
    normal_force: FloatArray
    dual: FloatArray | None = None

    def with_contact(self, contact: PlateContact) -> "PlateFriction":
        """Return the same friction with the plate and the normal force of `contact`."""
        return replace(self, plate=contact.surface, normal_force=contact.normal_force)

    @property
    def sliding_velocity(self) -> FloatArray:
        """Velocity of the plate within its plane, per travel."""
        n, v = self.plate.normal, self.plate.velocity
        return np.asarray(v - (v @ n) * n)

    def slip(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Return the tangential slip of the nodes of `x`, (n, 3), in this step; (c, 3) in mm."""
        moved = x[self.nodes.index] - self.slip_origin
        moved -= (travel_mm - self.start_travel_mm) * self.plate.velocity
        n = self.plate.normal
        return np.asarray(moved - (moved @ n)[:, None] * n)

    def direction(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Return the direction of slip, of length at most 1, shape (c, 3)."""
        s = self.slip(x, travel_mm)
        return np.asarray(s / np.sqrt((s * s).sum(axis=1) + SLIP_EPSILON_MM**2)[:, None])

    def with_direction_moved(
        self, length: float, x: FloatArray, travel_mm: float, u: FloatArray, travel: float
    ) -> "PlateFriction":
        """Return the friction with its direction, an unknown, moved by a fraction of a step.

        The step starts at (x, travel_mm) and runs along (u, travel).
        """
        if self.dual is None:
            raise AssertionError("the direction is not an unknown")
        s, moved, n = self.slip(x, travel_mm), u[self.nodes.index], self.plate.normal
        moved = moved - travel * self.plate.velocity
        moved -= (moved @ n)[:, None] * n
        root = np.sqrt((s * s).sum(axis=1) + SLIP_EPSILON_MM**2)[:, None]
        unit = s / root
        along = (unit * moved).sum(axis=1, keepdims=True)
        dual = self.dual + length * ((moved - along * self.dual) / root + unit - self.dual)
        size = np.sqrt((dual * dual).sum(axis=1, keepdims=True))
        return replace(self, dual=dual / np.maximum(size, 1.0))

    def next_slip_origin(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Return the slip origin of the next step: node positions minus retained slip, (c, 3).

        Short slips are kept in full, so that the number of steps hardly matters; of long slips
        `CONTACT_RESERVE_MM` is kept.
        """
        s = self.slip(x, travel_mm)
        far = (s * s).sum(axis=1) / CONTACT_RESERVE_MM**2
        kept = (1 + far**4) ** -0.125 * (self.normal_force > 0)
        return np.asarray(x[self.nodes.index] - kept[:, None] * s)

    def potential(self, x: FloatArray, travel_mm: float) -> ContactPotential:
        """Return D, summed over the contact nodes, and its derivatives."""
        s = self.slip(x, travel_mm)
        n, along = self.plate.normal, self.sliding_velocity
        root = np.sqrt((s * s).sum(axis=1) + SLIP_EPSILON_MM**2)
        limit = self.coefficient * self.normal_force
        force = (limit / root)[:, None] * s
        tangential = np.eye(3) - np.outer(n, n)
        unit = s / root[:, None]
        turned = unit if self.dual is None else self.dual
        turned = turned[:, :, None] * unit[:, None, :]
        if self.dual is not None:
            turned = (turned + turned.transpose(0, 2, 1)) / 2
        stiffness = (limit / root)[:, None, None] * (tangential - turned)
        coupling = -stiffness @ along
        return ContactPotential(
            energy=float(limit @ (root - SLIP_EPSILON_MM)),
            force=force,
            stiffness=stiffness,
            travel_force=-float(force.sum(axis=0) @ along),
            coupling=coupling,
            travel_stiffness=-float(coupling.sum(axis=0) @ along),
        )
