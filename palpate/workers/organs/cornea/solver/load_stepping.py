"""Adaptive load steps from one equilibrium to another."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.solver.envelope_lu import Factors
from palpate.workers.organs.cornea.solver.newton import Newton, solve_stage
from palpate.workers.organs.cornea.solver.system import Stage, System

# Fractions of the way: the path ends if a smaller step would be needed.
SMALLEST_STEP = 1e-3
GROWTH = 1.5


@dataclass(frozen=True, eq=False)
class Path:
    """The result of following an equilibrium.

    Parameters
    ----------
    u : ndarray, shape (n, 2)
        The last displacement in equilibrium, from the image, in mm.
    reason : str
        Why the path ended early; empty if it reached the requested stage.
    fraction : float
        Completed fraction of the way.
    steps, cuts, iterations, factorisations : int
    min_j : float
    factors : Factors or None
    """

    u: FloatArray
    reason: str
    fraction: float
    steps: int
    cuts: int
    iterations: int
    factorisations: int
    min_j: float
    factors: Factors | None


def follow(
    system: System,
    start: FloatArray,
    begin: Stage,
    end: Stage,
    first_step: float,
    factors: Factors | None = None,
) -> Path:
    """Follow an equilibrium from stage `begin` to stage `end`.

    Each step starts from the parabola, or the line, through the previous equilibria.
    """
    past: list[tuple[float, FloatArray]] = [(0.0, start)]
    step, steps, cuts, iterations, factorised = first_step, 0, 0, 0, 0
    min_j = np.inf
    while past[-1][0] < 1:
        fraction = min(1.0, past[-1][0] + step)
        if 1 - fraction < SMALLEST_STEP:
            fraction = 1.0
        guess = _extrapolate(past, fraction)
        result = solve_stage(system, begin.towards(end, fraction), guess, factors)
        iterations += result.iterations
        factorised += result.factorisations
        if result.reason:
            cuts += 1
            step = (fraction - past[-1][0]) / 2
            factors = None
            if step < SMALLEST_STEP:
                return _path(past, result, steps, cuts, iterations, factorised, min_j)
            continue
        steps += 1
        past = [*past[-2:], (fraction, result.u)]
        factors, min_j = result.factors, result.min_j
        step *= GROWTH
    done = Newton(past[-1][1], "", iterations, factorised, min_j, factors)
    return _path(past, done, steps, cuts, iterations, factorised, min_j)


def _path(
    past: list[tuple[float, FloatArray]],
    last: Newton,
    steps: int,
    cuts: int,
    iterations: int,
    factorised: int,
    min_j: float,
) -> Path:
    fraction, u = past[-1]
    return Path(u, last.reason, fraction, steps, cuts, iterations, factorised, min_j, last.factors)


def _extrapolate(past: list[tuple[float, FloatArray]], fraction: float) -> FloatArray:
    """Return the polynomial through the past equilibria at a fraction of the way."""
    guess = np.zeros_like(past[-1][1])
    for i, (here, u) in enumerate(past):
        weight = 1.0
        for j, (there, _) in enumerate(past):
            if i != j:
                weight *= (fraction - there) / (here - there)
        guess += weight * u
    return guess
