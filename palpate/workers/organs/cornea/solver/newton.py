"""Newton's method that reuses a factored tangent while it is useful.

Steps are judged by the next correction with the same factors, an error in mm that does not
depend on the stiffness of a direction (the natural monotonicity test; P. Deuflhard, Newton
Methods for Nonlinear Problems, 2004, ch. 3): the membrane of a cornea is a thousand times
stiffer than its bending, so a residual in N is not informative. If that correction is much
shorter than the step, the factors are reused, which saves an assembly and a factorisation.
"""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.solver.envelope_lu import Factors
from palpate.workers.organs.cornea.solver.system import Stage, System

MAX_ITERATIONS = 25
MAX_HALVINGS = 8
# Longest displacement of any node per iteration; beyond it the tangent is not valid.
LONGEST_STEP_MM = 0.2
# The tangent is renewed unless a correction is shorter than the last one by this factor.
KEEP_FACTORS_BELOW = 0.15


@dataclass(frozen=True, eq=False)
class Newton:
    """The result of Newton's method; `reason` is empty if it converged.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        Displacement from the image in mm.
    reason : str
    iterations, factorisations : int
    min_j : float
    factors : Factors or None
        The latest ones, of a tangent near u.
    """

    u: FloatArray
    reason: str
    iterations: int
    factorisations: int
    min_j: float
    factors: Factors | None


def solve_stage(
    system: System, stage: Stage, start: FloatArray, factors: Factors | None = None
) -> Newton:
    """Find the equilibrium near `start`, (n, 2) in mm, under a stage of the load.

    Given `factors`, of a tangent near the start, are tried first.
    """
    tolerance = system.prepared.model.tolerance_mm
    u = system.held_at(start, stage)
    residual, min_j = system.residual(u, stage)
    factorised, fresh, length = 0, False, np.inf
    step: FloatArray | None = None if factors is None else -factors.solve(residual)
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not (min_j > 0 and np.isfinite(residual).all()):
            return Newton(u, "an element is squeezed flat", iteration, factorised, min_j, factors)
        if step is None or factors is None:
            residual, min_j, factors = system.linearise(u, stage)
            factorised, fresh = factorised + 1, True
            if factors.singular:
                return Newton(u, "the tangent is singular", iteration, factorised, min_j, None)
            step = -factors.solve(residual)
        length = float(np.abs(step).max())
        if length <= tolerance:
            u = u + system.prepared.spread(step)
            return Newton(u, "", iteration, factorised, min_j, factors)
        part, trial = _line_search(system, stage, u, step, factors)
        if trial is None and not fresh:
            step = None
            continue
        if trial is None:
            reason = f"no step lowers the error of {1e3 * length:.3g} um"
            return Newton(u, reason, iteration, factorised, min_j, factors)
        u, residual, min_j, following = trial
        fresh = False
        contraction = float(np.abs(following).max()) / length
        if part == 1 and contraction < KEEP_FACTORS_BELOW:
            if contraction * length <= tolerance:
                u = u + system.prepared.spread(following)
                return Newton(u, "", iteration, factorised, min_j, factors)
            step = following
        else:
            step = None
    reason = f"{MAX_ITERATIONS} Newton iterations left an error of {1e3 * length:.3g} um"
    return Newton(u, reason, MAX_ITERATIONS, factorised, min_j, factors)


_Trial = tuple[FloatArray, FloatArray, float, FloatArray]


def _line_search(
    system: System, stage: Stage, u: FloatArray, step: FloatArray, factors: Factors
) -> tuple[float, _Trial | None]:
    """Shorten a step until the next correction is shorter than the step.

    Returns the accepted fraction of the step, and the displacement, residual, smallest J and
    correction there; None if no fraction is acceptable.
    """
    length = float(np.linalg.norm(step))
    part = min(1.0, LONGEST_STEP_MM / float(np.abs(step).max()))
    direction = system.prepared.spread(step)
    for _ in range(MAX_HALVINGS):
        there = u + part * direction
        residual, min_j = system.residual(there, stage)
        if min_j > 0 and np.isfinite(residual).all():
            following = -factors.solve(residual)
            if np.linalg.norm(following) <= (1 - part / 4) * length:
                return part, (there, residual, min_j, following)
        part /= 2
    return 0.0, None
