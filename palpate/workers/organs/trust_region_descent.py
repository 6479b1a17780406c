"""Descent to the least sum of squares, by Gauss-Newton steps with a trust region.

A descent (Levenberg-Marquardt) is an immutable value. Near a point the sum of squares is
:math:`c + 2 g's + s'Hs` with g = J'r and H = J'J. Its minimum within the bounds and the box of the
trust region is found exactly; the region shrinks if the step achieved less than a quarter of the
predicted reduction, and grows if it achieved three quarters (J. Nocedal, S. Wright, Numerical
Optimization, 2nd ed., algorithm 4.1). In a narrow, curved valley a long step ends on the wall.
Before it is rejected, a second step from there returns to the floor, and both are judged together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.normal_equations import NormalEquations

# The first step changes no constant by more than a factor of two; later ones e^2 at most.
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.7, 2.0, 1e-4
SHRINK_BELOW, GROW_ABOVE = 0.25, 0.75
# Directions below this fraction of the largest curvature are ignored.
RIDGE = 1e-9
# The same for the second step, back from the wall of a valley.
WALL = 1e-2


@dataclass(frozen=True)
class Tolerance:
    """Smallest predicted reduction of the sum of squares that is worth another step.

    The descent has converged when the prediction is below the larger of the two limits.

    Parameters
    ----------
    noises : float
        Relative to the noise variance: 0.1 is a third of a standard deviation, which the
        intervals of the constants include.
    part : float
        Relative to the sum of squares.
    """

    noises: float
    part: float = 0.0

    def least_fall(self, here: NormalEquations) -> float:
        """Return the smallest worthwhile reduction at a point."""
        return max(self.noises * here.noise, self.part * here.cost)


class Box(NamedTuple):
    """The smallest and the largest coordinates, shape (d,)."""

    lower: FloatArray
    upper: FloatArray

    def part(self, index: Sequence[int]) -> "Box":
        """Return the box of some of the coordinates."""
        return Box(self.lower[index], self.upper[index])


DescentState = Literal["running", "converged", "failed", "merged"]


@dataclass(frozen=True, eq=False)
class Descent:
    """The state of a descent.

    Parameters
    ----------
    at : ndarray, shape (d,)
        The best point so far, or the starting point.
    here : NormalEquations or None
        The sum of squares at `at`; None before the first evaluation.
    trial : ndarray, shape (d,)
        The next point to evaluate.
    expected : float
        Predicted reduction of the sum of squares at `trial`.
    radius : float
    state : {"running", "converged", "failed", "merged"}
    evaluations : int
    second : bool
        Whether the trial corrects a step that achieved too little.
    """

    at: FloatArray
    here: NormalEquations | None
    trial: FloatArray
    expected: float
    radius: float
    state: DescentState
    evaluations: int = 0
    second: bool = False

    @property
    def cost(self) -> float:
        """Return the smallest sum of squares so far; infinite before the first evaluation."""
        return np.inf if self.here is None else self.here.cost


def begin_descent(at: FloatArray, radius: float = FIRST_RADIUS) -> Descent:
    """Return a descent that starts at a point."""
    return Descent(at, None, at, 0.0, radius, "running")


def descend(
    equations: Callable[[FloatArray], NormalEquations | None],
    start: FloatArray,
    box: Box,
    tolerance: Tolerance,
    most: int,
) -> Descent:
    """Return the descent from a point to its end, with each trial evaluated by `equations`."""
    descent = begin_descent(start)
    while descent.state == "running":
        descent = advance_descent(descent, equations(descent.trial), box, tolerance, most)
    return descent


def advance_descent(
    descent: Descent, there: NormalEquations | None, box: Box, tolerance: Tolerance, most: int
) -> Descent:
    """Return the descent after the evaluation of its trial point.

    Parameters
    ----------
    there : NormalEquations or None
        None if the simulation failed.
    tolerance : Tolerance
    most : int
        Maximum number of evaluations.
    """
    counted = replace(descent, evaluations=descent.evaluations + 1)
    if descent.here is None:
        if there is None:
            return replace(counted, state="failed")
        return _next_descent(replace(counted, here=there), box, tolerance, most)
    longest = float(np.abs(descent.trial - descent.at).max())
    gained = -np.inf if there is None else descent.here.cost - there.cost
    share = gained / descent.expected
    moved = replace(counted, second=False)
    if there is not None and gained > 0:
        moved = replace(moved, at=descent.trial, here=there)
    if there is not None and share < SHRINK_BELOW and not descent.second:
        if gained > 0:
            return _next_descent(moved, box, tolerance, most, second=True)
        back, fall = best_step(there, descent.trial, descent.radius, box, WALL)
        if gained + fall > SHRINK_BELOW * descent.expected and counted.evaluations < most:
            trial = np.clip(descent.trial + back, box.lower, box.upper)
            return replace(counted, trial=trial, second=True)
    radius = descent.radius
    if share < SHRINK_BELOW:
        radius = SHRINK_BELOW * min(longest, radius)
    elif share > GROW_ABOVE and (descent.second or longest > 0.99 * radius):
        radius = min(2 * radius, LARGEST_RADIUS)
    return _next_descent(replace(moved, radius=radius), box, tolerance, most)


def _next_descent(
    descent: Descent, box: Box, tolerance: Tolerance, most: int, second: bool = False
) -> Descent:
    here = descent.here
    if here is None:
        raise AssertionError("a descent continues from an evaluation")
    step, expected = best_step(here, descent.at, descent.radius, box)
    small = expected < tolerance.least_fall(here) or descent.radius < SMALLEST_RADIUS
    if small or descent.evaluations >= most:
        return replace(descent, trial=descent.at, expected=0.0, state="converged")
    trial = np.clip(descent.at + step, box.lower, box.upper)
    return replace(descent, trial=trial, expected=expected, second=second)


def best_step(
    here: NormalEquations, at: FloatArray, radius: float, box: Box, part: float = RIDGE
) -> tuple[FloatArray, float]:
    """Return the step to the minimum within the trust region, and its predicted reduction.

    Directions below a `part` of the largest curvature are ignored.
    """
    from scipy.optimize import lsq_linear  # slow to import, and not needed to read a study

    d = len(at)
    if d == 0:
        return np.zeros(0), 0.0
    ridge = part * max(float(np.trace(here.hessian)) / d, 1e-300)
    root = np.linalg.cholesky(here.hessian + ridge * np.eye(d)).T
    low = np.maximum(box.lower - at, -radius)
    high = np.minimum(box.upper - at, radius)
    wanted = -np.linalg.solve(root.T, here.gradient)
    step = np.asarray(lsq_linear(root, wanted, (low, high), method="bvls").x)
    fall = -float(2 * here.gradient @ step + step @ here.hessian @ step)
    return step, max(fall, 0.0)


def with_held(
    here: NormalEquations, at: FloatArray, index: int, value: float, radius: float, box: Box
) -> FloatArray:
    """Hold one coordinate at a value, and predict the best values of the others by derivatives."""
    others = [i for i in range(len(at)) if i != index]
    predicted = at.copy()
    predicted[index] = value
    gradient = here.gradient + here.hessian[:, index] * (value - at[index])
    part = replace(here, gradient=gradient).part(others)
    predicted[others] += best_step(part, at[others], radius, box.part(others))[0]
    return predicted
