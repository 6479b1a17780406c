"""Outcome of a simulation.

::

    solve --> converged                      a displacement in equilibrium
          `-> diverged(reason)               an ordinary ending, scored worst
"""

from dataclasses import asdict, dataclass
from typing import Any

from palpate.storage.values import FloatArray

# A result with an element squeezed below this volume ratio is not to be trusted.
SQUEEZED_J = 0.3


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a simulation, with measures of its reliability.

    Parameters
    ----------
    converged : bool
    reason : str
        Reason for divergence; empty if it converged.
    newton_iterations, cg_iterations : tuple of int
        Iterations on each level, coarse to fine.
    residual_n : float
        Norm of the out-of-balance force on the free degrees of freedom.
    plate_displacement_mm : float
        Downward displacement of the upper plate.
    plate_force_n : float
        Force on the upper plate.
    contact_area_mm2 : float
        Undeformed surface area pressed against the upper plate.
    penetration_mm : float
        Deepest node inside a plate, a measure of the penalty's error.
    min_j : float
        Smallest volume ratio of an element.
    energy_mj : float
        Stored energy in mJ (= N mm).
    force_imbalance : float
        ``|upper - lower| / upper`` of the forces on the two plates.
    wall_force_n : float
        Reaction of the chest wall along z.
    squeezed : bool
        Whether it converged, but with an element of J < 0.3.
    """

    converged: bool
    reason: str
    newton_iterations: tuple[int, ...]
    cg_iterations: tuple[int, ...]
    residual_n: float
    plate_displacement_mm: float
    plate_force_n: float
    contact_area_mm2: float
    penetration_mm: float
    min_j: float
    energy_mj: float
    force_imbalance: float
    wall_force_n: float
    squeezed: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the values as a JSON-serialisable dict."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Displacement of the finest mesh, shape (n, 3) in mm, and the outcome."""

    displacement_mm: FloatArray
    outcome: Outcome
