r"""Coulomb friction between skin and plates, in load steps.

Within one step a contact node that carries the normal force lambda and slips by s
against its plate dissipates

.. math:: D = \mu \lambda (\sqrt{s^2 + \epsilon^2} - \epsilon) ,

which is Coulomb's law except for slips of the order of epsilon, over which friction
builds up (a regularised pseudo-potential). Slip is measured from an origin: the node's
position when it began to slip, dragged along behind it from step to step, so that a
sticking node does not creep. lambda is the force of the present state: every step ends
in implicit Coulomb equilibrium. Its derivative is in
`workers.mechanics.fem.equilibrium.coupled_tangent`.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.contact.contact_potential import ContactNodes, ContactPotential
from palpate.workers.mechanics.fem.contact.plate_surface import PlateSurface
from palpate.workers.mechanics.fem.contact.plates import PlateContact

# Friction is half built up after 0.6 epsilon.
EPSILON_MM = 0.05
# Slip that a sliding node keeps when it reverses; friction is then at 95 %.
RESERVE_MM = 3 * EPSILON_MM


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
        return np.asarray(s / np.sqrt((s * s).sum(axis=1) + EPSILON_MM**2)[:, None])

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
        root = np.sqrt((s * s).sum(axis=1) + EPSILON_MM**2)[:, None]
        unit = s / root
        along = (unit * moved).sum(axis=1, keepdims=True)
        dual = self.dual + length * ((moved - along * self.dual) / root + unit - self.dual)
        size = np.sqrt((dual * dual).sum(axis=1, keepdims=True))
        return replace(self, dual=dual / np.maximum(size, 1.0))

    def next_slip_origin(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Return the slip origin of the next step: node positions minus retained slip, (c, 3).

        Short slips are kept in full, so that the number of steps hardly matters; of long slips
        `RESERVE_MM` is kept.
        """
        s = self.slip(x, travel_mm)
        far = (s * s).sum(axis=1) / RESERVE_MM**2
        kept = (1 + far**4) ** -0.125 * (self.normal_force > 0)
        return np.asarray(x[self.nodes.index] - kept[:, None] * s)

    def potential(self, x: FloatArray, travel_mm: float) -> ContactPotential:
        """Return D, summed over the contact nodes, and its derivatives."""
        s = self.slip(x, travel_mm)
        n, along = self.plate.normal, self.sliding_velocity
        root = np.sqrt((s * s).sum(axis=1) + EPSILON_MM**2)
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
            energy=float(limit @ (root - EPSILON_MM)),
            force=force,
            stiffness=stiffness,
            travel_force=-float(force.sum(axis=0) @ along),
            coupling=coupling,
            travel_stiffness=-float(coupling.sum(axis=0) @ along),
        )
