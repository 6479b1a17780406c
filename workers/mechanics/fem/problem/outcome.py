"""How a simulation ended.

::

    solve --> converged                      a displacement in equilibrium
          `-> diverged(reason)               an ordinary ending, scored worst
"""

from dataclasses import asdict, dataclass
from typing import Any

from palpate.storage.values import FloatArray

# An answer with an element squeezed below this volume ratio is not to be trusted.
SQUEEZED_J = 0.3


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a simulation ended, and how far to trust it.

    Parameters
    ----------
    converged : bool
    reason : str
        Why it diverged; empty when it converged.
    newton_iterations, cg_iterations : tuple of int
        Per level, coarse to fine.
    residual_n : float
        Norm of the out-of-balance force on the free degrees of freedom.
    plate_displacement_mm : float
        How far the upper plate has moved down.
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
        ``|upper - lower| / upper``: what the two plates carry, compared.
    wall_force_n : float
        Reaction of the chest wall along z.
    squeezed : bool
        Converged, but some element has J < 0.3.
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
        """Return plain JSON-able values."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Displacement of the finest mesh, shape (n, 3) in mm, and how it was reached."""

    displacement_mm: FloatArray
    outcome: Outcome
