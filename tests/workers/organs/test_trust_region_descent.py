"""Descents along a narrow, curved valley."""

import numpy as np
import pytest

from palpate.service.search.search_interface import FloatArray, LogSpace, Space
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.trust_region_descent import (
    Tolerance,
    advance_descent,
    begin_descent,
    descend,
    with_held,
)

LOGS = LogSpace(Space.from_bounds({"x": (-4, 4), "y": (-4, 16)}))
TOLERANCE = Tolerance(0.01)
# Stiffness of the wall; the floor is y = x^2.
STEEP = 1e3
FLOOR = np.array([3.0, 9.0])


def valley(at: FloatArray) -> NormalEquations:
    x, y = LOGS.genes(at)
    width = LOGS.width
    r = np.array([STEEP * (y - x**2), 10 * (x - FLOOR[0])])
    J = np.array([[-2 * STEEP * x, STEEP], [10.0, 0.0]]) * width
    return NormalEquations(float(r @ r), J.T @ r, J.T @ J, 1000)


@pytest.mark.parametrize("start", [(-2.0, 4.0), (0.5, 6.0), (-3.5, 0.0)])
def test_descent_follows_a_curved_valley_to_its_minimum(start: tuple[float, float]) -> None:
    """Along the floor, in steps of a tenth of its width, it would take a hundred."""
    descent = begin_descent(LOGS.coordinates(np.array(start)))
    costs = []
    while descent.state == "running":
        descent = advance_descent(descent, valley(descent.trial), LOGS.box, TOLERANCE, 40)
        costs.append(descent.cost)
    assert costs == sorted(costs, reverse=True)
    np.testing.assert_allclose(LOGS.genes(descent.at), FLOOR, atol=0.02)


def test_rejects_a_second_step_that_fails() -> None:
    descent = begin_descent(LOGS.coordinates(np.array([-2.0, 4.0])))
    descent = advance_descent(descent, valley(descent.trial), LOGS.box, TOLERANCE, 40)
    descent = advance_descent(descent, valley(descent.trial), LOGS.box, TOLERANCE, 40)
    assert descent.second
    before = descent.at
    descent = advance_descent(descent, None, LOGS.box, TOLERANCE, 40)
    assert not descent.second
    assert descent.radius < 0.7 / 2
    np.testing.assert_array_equal(descent.at, before)


def test_others_follow_a_held_coordinate() -> None:
    """Held at x, the best y is on the floor; a descent of no coordinates ends at once."""
    at = LOGS.coordinates(np.array([2.0, 4.0]))
    held = float(LOGS.coordinates(np.array([2.1, 0.0]))[0])
    predicted = LOGS.genes(with_held(valley(at), at, 0, held, 1.0, LOGS.box))
    np.testing.assert_allclose(predicted, [2.1, 4.4], atol=1e-3)
    box = LOGS.box.part([])
    end = descend(lambda _: valley(at).part([]), np.zeros(0), box, TOLERANCE, 3)
    assert (end.state, end.evaluations) == ("converged", 1)
