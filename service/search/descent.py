r"""One descent of Gauss, Newton, Levenberg and Marquardt, as a value.

Near a point the sum of squares is :math:`c + 2 g's + s'Hs` with g = J'r and H = J'J. Its least
value within the bounds and within a box of the trust region is found exactly; the region
shrinks where the step kept less than a quarter of what was expected of it, and grows where it
kept three quarters (J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., algorithm 4.1).
In a narrow valley that bends a long step ends on its wall. Before it is given up, a second one
from there leads back to the floor, and both together are judged as one.

Constants are in the coordinates of `service.search.log_space`.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from palpate.service.search.log_space import LogSpace
from palpate.service.search.space import FloatArray
from palpate.storage.records.tasks import FitJson

# The first step changes no constant by more than a factor of two; later ones e^2 at most.
FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.7, 2.0, 1e-4
SHRINK_BELOW, GROW_ABOVE = 0.25, 0.75
# Below this part of the largest curvature a direction is not followed.
RIDGE = 1e-9
# Nor is it on the way back from the wall of a valley, below this part.
WALL = 1e-2


@dataclass(frozen=True)
class Tolerance:
    """By how much a sum of squares should fall for another step to be worth it.

    It has converged when less than the larger of both is expected.

    Parameters
    ----------
    noises : float
        In units of the noise that it shows: 0.1 is a third of a standard deviation, which the
        intervals of the constants include.
    part : float
        Of the sum itself.
    """

    noises: float
    part: float = 0.0

    def least_fall(self, here: "SquaredSum") -> float:
        """Return the larger of both at a point."""
        return max(self.noises * here.noise, self.part * here.value)


State = Literal["running", "converged", "failed", "merged"]


@dataclass(frozen=True, eq=False)
class SquaredSum:
    """The sum of squares at a point: its value, half its gradient, and J'J; see above."""

    value: float
    gradient: FloatArray
    hessian: FloatArray
    residuals: int

    @classmethod
    def of(
        cls, fit: FitJson, logs: LogSpace, order: list[int], per_inside: FloatArray
    ) -> "SquaredSum":
        """Return that of an evaluation, in the coordinates of `logs`.

        Parameters
        ----------
        order : list of int
            Where each gene stands in the fit.
        per_inside : ndarray, shape (d,)
            How many units at the door make one inside.
        """
        scale = np.where(logs.logarithmic, 1.0, logs.width / per_inside)
        g = np.asarray(fit["gradient"], np.float64)[order] * scale
        h = np.asarray(fit["hessian"], np.float64)[np.ix_(order, order)] * np.outer(scale, scale)
        return cls(float(fit["cost"]), g, h, int(fit["residuals"]))

    @property
    def noise(self) -> float:
        """Return how many times the expected one the variance is; 1 if not larger."""
        return max(1.0, self.value / max(1, self.residuals - len(self.gradient)))


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent stands.

    Parameters
    ----------
    at : ndarray, shape (d,)
        The best point so far, or the first one.
    here : SquaredSum or None
        There; None before the first evaluation.
    trial : ndarray, shape (d,)
        The point to be evaluated next.
    expected : float
        By how much the sum of squares should fall there.
    radius : float
    state : {"running", "converged", "failed", "merged"}
    evaluations : int
    second : bool
        Whether the trial makes good for a step that kept too little.
    """

    at: FloatArray
    here: SquaredSum | None
    trial: FloatArray
    expected: float
    radius: float
    state: State
    evaluations: int = 0
    second: bool = False

    @property
    def cost(self) -> float:
        """Return the least sum of squares so far; infinite before the first."""
        return np.inf if self.here is None else self.here.value


def begin(at: FloatArray, radius: float = FIRST_RADIUS) -> Descent:
    """Return a descent that begins at a point."""
    return Descent(at, None, at, 0.0, radius, "running")


def advance(
    descent: Descent, there: SquaredSum | None, logs: LogSpace, tolerance: Tolerance, most: int
) -> Descent:
    """Return the descent after the evaluation of its trial point.

    Parameters
    ----------
    there : SquaredSum or None
        None where the simulation failed.
    tolerance : Tolerance
    most : int
        Evaluations; the best point then stands.
    """
    counted = replace(descent, evaluations=descent.evaluations + 1)
    if descent.here is None:
        if there is None:
            return replace(counted, state="failed")
        return _next(replace(counted, here=there), logs, tolerance, most)
    longest = float(np.abs(descent.trial - descent.at).max())
    gained = -np.inf if there is None else descent.here.value - there.value
    share = gained / descent.expected
    moved = replace(counted, second=False)
    if there is not None and gained > 0:
        moved = replace(moved, at=descent.trial, here=there)
    if there is not None and share < SHRINK_BELOW and not descent.second:
        if gained > 0:
            return _next(moved, logs, tolerance, most, second=True)
        back, fall = best_step(there, descent.trial, descent.radius, logs, WALL)
        if gained + fall > SHRINK_BELOW * descent.expected and counted.evaluations < most:
            trial = np.clip(descent.trial + back, logs.lower, logs.upper)
            return replace(counted, trial=trial, second=True)
    radius = descent.radius
    if share < SHRINK_BELOW:
        radius = SHRINK_BELOW * min(longest, radius)
    elif share > GROW_ABOVE and (descent.second or longest > 0.99 * radius):
        radius = min(2 * radius, LARGEST_RADIUS)
    return _next(replace(moved, radius=radius), logs, tolerance, most)


def _next(
    descent: Descent, logs: LogSpace, tolerance: Tolerance, most: int, second: bool = False
) -> Descent:
    here = descent.here
    if here is None:
        raise AssertionError("a descent goes on from an evaluation")
    step, expected = best_step(here, descent.at, descent.radius, logs)
    small = expected < tolerance.least_fall(here) or descent.radius < SMALLEST_RADIUS
    if small or descent.evaluations >= most:
        return replace(descent, trial=descent.at, expected=0.0, state="converged")
    trial = np.clip(descent.at + step, logs.lower, logs.upper)
    return replace(descent, trial=trial, expected=expected, second=second)


def best_step(
    here: SquaredSum, at: FloatArray, radius: float, logs: LogSpace, part: float = RIDGE
) -> tuple[FloatArray, float]:
    """Return the step to the least sum of squares in reach, and by how much that should fall.

    Directions below a `part` of the largest curvature are not followed.
    """
    from scipy.optimize import lsq_linear  # slow to import, and reading a study takes no step

    d = len(at)
    ridge = part * max(float(np.trace(here.hessian)) / d, 1e-300)
    root = np.linalg.cholesky(here.hessian + ridge * np.eye(d)).T
    low = np.maximum(logs.lower - at, -radius)
    high = np.minimum(logs.upper - at, radius)
    wanted = -np.linalg.solve(root.T, here.gradient)
    step = np.asarray(lsq_linear(root, wanted, (low, high), method="bvls").x)
    fall = -float(2 * here.gradient @ step + step @ here.hessian @ step)
    return step, max(fall, 0.0)
