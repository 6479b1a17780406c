r"""Coulomb friction between skin and plates, in steps of the load.

Within one step a pad that carries the normal force lambda and slips by s against
its plate dissipates

.. math:: D = \mu \lambda (\sqrt{s^2 + \epsilon^2} - \epsilon) ,

Coulomb's law but for slips of the order of epsilon, over which friction builds up.
Slip is counted from an anchor: where the pad was when it began to slip, dragged along
behind it from step to step, so that a pad that sticks does not creep. lambda is the
force of the present state: it is held during a minimisation and renewed after it
until it no longer changes, so every step ends in implicit Coulomb equilibrium. Its
derivative enters the tangent of `workers.fem.sensitivity`.
"""

from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.fem.contact import Bordered, Pads, Press, Surface

# Friction is half built up after 0.6 epsilon.
EPSILON_MM = 0.05
# What a pad that slips has in reserve when it turns back; friction is then at 95 %.
HELD_MM = 3 * EPSILON_MM
STEPS = 8


@dataclass(frozen=True, eq=False)
class Grip:
    """Friction of one plate during one step of the load.

    Parameters
    ----------
    pads : Pads
    plate : Surface
    friction : float
        Coulomb's coefficient mu.
    start : ndarray, shape (c, 3)
        The anchors at the beginning of the step, in mm.
    start_travel_mm : float
    load : ndarray, shape (c,)
        Normal force lambda of each pad, in N.
    """

    pads: Pads
    plate: Surface
    friction: float
    start: FloatArray
    start_travel_mm: float
    load: FloatArray

    def renewed(self, press: Press) -> "Grip":
        """The same grip with the normal force of the present state."""
        return Grip(
            self.pads, press.surface, self.friction, self.start, self.start_travel_mm, press.load
        )

    @property
    def along(self) -> FloatArray:
        """Velocity of the plate within its own plane, per travel."""
        n, v = self.plate.normal, self.plate.velocity
        return np.asarray(v - (v @ n) * n)

    def slip(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Tangential slip of the pads of `x`, shape (n, 3), in this step; (c, 3) in mm."""
        moved = x[self.pads.nodes] - self.start
        moved -= (travel_mm - self.start_travel_mm) * self.plate.velocity
        n = self.plate.normal
        return np.asarray(moved - (moved @ n)[:, None] * n)

    def direction(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Direction in which friction is overcome, at most 1 long, shape (c, 3)."""
        s = self.slip(x, travel_mm)
        return np.asarray(s / np.sqrt((s * s).sum(axis=1) + EPSILON_MM**2)[:, None])

    def anchor(self, x: FloatArray, travel_mm: float) -> FloatArray:
        """Where slip counts from in the next step: the pads less what has not slipped.

        Short slips are kept whole, so that the number of steps hardly matters, and of
        long ones `HELD_MM`.
        """
        s = self.slip(x, travel_mm)
        far = (s * s).sum(axis=1) / HELD_MM**2
        kept = (1 + far**4) ** -0.125 * (self.load > 0)
        return np.asarray(x[self.pads.nodes] - kept[:, None] * s)

    def drag(self, x: FloatArray, travel_mm: float) -> Bordered:
        """D, summed over the pads, and its derivatives."""
        s = self.slip(x, travel_mm)
        n, along = self.plate.normal, self.along
        root = np.sqrt((s * s).sum(axis=1) + EPSILON_MM**2)
        limit = self.friction * self.load
        force = (limit / root)[:, None] * s
        tangential = np.eye(3) - np.outer(n, n)
        unit = s / root[:, None]
        stiffness = (limit / root)[:, None, None] * (
            tangential - unit[:, :, None] * unit[:, None, :]
        )
        coupling = -stiffness @ along
        return Bordered(
            energy=float(limit @ (root - EPSILON_MM)),
            force=force,
            stiffness=stiffness,
            travel_force=-float(force.sum(axis=0) @ along),
            coupling=coupling,
            travel_stiffness=-float(coupling.sum(axis=0) @ along),
        )
