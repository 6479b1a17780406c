"""A descent goes along a narrow valley that bends, and ends at the bottom of it."""

import numpy as np
import pytest

from palpate.service.search.descent import SquaredSum, Tolerance, advance, begin
from palpate.service.search.log_space import LogSpace
from palpate.service.search.space import FloatArray, Space

LOGS = LogSpace(Space.from_bounds({"x": (-4, 4), "y": (-4, 16)}))
TOLERANCE = Tolerance(0.01)
# Of the wall; the floor is y = x^2.
STEEP = 1e3
FLOOR = np.array([3.0, 9.0])


def valley(at: FloatArray) -> SquaredSum:
    x, y = LOGS.genes(at)
    width = LOGS.width
    r = np.array([STEEP * (y - x**2), 10 * (x - FLOOR[0])])
    J = np.array([[-2 * STEEP * x, STEEP], [10.0, 0.0]]) * width
    return SquaredSum(float(r @ r), J.T @ r, J.T @ J, 1000)


@pytest.mark.parametrize("start", [(-2.0, 4.0), (0.5, 6.0), (-3.5, 0.0)])
def test_the_bottom_of_a_bent_valley_is_reached(start: tuple[float, float]) -> None:
    """Step by step along its floor, a tenth of a width each, it would take a hundred."""
    descent = begin(LOGS.coordinates(np.array(start)))
    costs = []
    while descent.state == "running":
        descent = advance(descent, valley(descent.trial), LOGS, TOLERANCE, 40)
        costs.append(descent.cost)
    assert costs == sorted(costs, reverse=True)
    np.testing.assert_allclose(LOGS.genes(descent.at), FLOOR, atol=0.02)


def test_a_second_step_that_fails_is_given_up() -> None:
    descent = begin(LOGS.coordinates(np.array([-2.0, 4.0])))
    descent = advance(descent, valley(descent.trial), LOGS, TOLERANCE, 40)
    descent = advance(descent, valley(descent.trial), LOGS, TOLERANCE, 40)
    assert descent.second
    before = descent.at
    descent = advance(descent, None, LOGS, TOLERANCE, 40)
    assert not descent.second
    assert descent.radius < 0.7 / 2
    np.testing.assert_array_equal(descent.at, before)
