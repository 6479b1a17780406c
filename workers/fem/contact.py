"""Two rigid frictionless plates, by a penalty on nodal areas.

Planes need no contact search: the gap of a node is its signed distance to the
plane. The penalty lets the body into the plate by pressure / 0.5 N/mm^3, which
is 0.04 mm at a mean pressure of 20 kPa.
"""

from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray, IntArray

PENALTY_N_PER_MM3 = 0.5


@dataclass(frozen=True, eq=False)
class Pads:
    """The nodes that may touch, shape (c,), and their stiffness, area x penalty, in N/mm."""

    nodes: IntArray
    stiffness: FloatArray


@dataclass(frozen=True, slots=True)
class Gap:
    """Where the plates stand: the body fits between ``lower_mm`` and ``upper_mm``."""

    lower_mm: float
    upper_mm: float

    def closed_by(self, distance_mm: float) -> "Gap":
        """The upper plate moved down by `distance_mm`."""
        return Gap(self.lower_mm, self.upper_mm - distance_mm)

    def towards(self, other: "Gap", fraction: float) -> "Gap":
        """Between this gap (0) and another (1)."""
        return Gap(
            self.lower_mm + fraction * (other.lower_mm - self.lower_mm),
            self.upper_mm + fraction * (other.upper_mm - self.upper_mm),
        )


@dataclass(frozen=True, eq=False)
class Touch:
    """Penetration of each pad into each plate, shape (c,) in mm, and what follows from it."""

    pads: Pads
    lower: FloatArray
    upper: FloatArray

    @property
    def energy(self) -> float:
        """Penalty energy in mJ."""
        return float(0.5 * self.pads.stiffness @ (self.lower**2 + self.upper**2))

    @property
    def upper_force(self) -> float:
        """Force on the upper plate in N."""
        return float(self.pads.stiffness @ self.upper)

    @property
    def lower_force(self) -> float:
        """Force on the lower plate in N."""
        return float(self.pads.stiffness @ self.lower)

    @property
    def force(self) -> FloatArray:
        """Along +y on each pad, as an internal force, in N."""
        return self.pads.stiffness * (self.upper - self.lower)

    @property
    def stiffness(self) -> FloatArray:
        """Derivative of `force` by y, in N/mm."""
        return self.pads.stiffness * ((self.upper > 0) | (self.lower > 0))

    @property
    def coupling(self) -> FloatArray:
        """Derivative of `force` by the travel of the upper plate, in N/mm."""
        return self.pads.stiffness * (self.upper > 0)


def touch(pads: Pads, x: FloatArray, gap: Gap) -> Touch:
    """Press the nodes at `x`, shape (n, 3), against the plates."""
    y = x[pads.nodes, 1]
    return Touch(pads, np.maximum(gap.lower_mm - y, 0.0), np.maximum(y - gap.upper_mm, 0.0))
