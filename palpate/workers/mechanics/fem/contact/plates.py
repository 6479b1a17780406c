r"""Contact with two rigid plates, by a penalty on nodal areas.

The body penetrates the plate by pressure / 0.5 N/mm^3, which is 0.04 mm at a mean pressure of
20 kPa. Faces that reach behind the edge of a plate are pressed at points inside them; see
`workers.mechanics.fem.contact.edge_contact`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.contact.contact_potential import ContactNodes, ContactPotential
from palpate.workers.mechanics.fem.contact.edge_contact import EdgeContact, edge_contact
from palpate.workers.mechanics.fem.contact.plate_surface import PlateSurface, SurfaceGap

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
