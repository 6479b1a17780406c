"""Robust normal equations against a direct minimisation and against differences."""

import numpy as np
import pytest
from scipy.optimize import minimize

from palpate.workers.organs.normal_equations import HUBER, normal_equations


def huber(e: np.ndarray) -> float:
    size = np.abs(e)
    return float(np.where(size <= HUBER, size**2, HUBER * (2 * size - HUBER)).sum())


@pytest.mark.parametrize("robust", [False, True])
def test_cost_is_the_minimum_over_the_common_error_and_its_derivative_is_twice_the_gradient(
    robust: bool,
) -> None:
    rng = np.random.default_rng(2)
    jacobian, common = rng.normal(size=(80, 3)), rng.normal(size=(80, 2))
    r = rng.normal(size=80) + 3 * (rng.random(80) < 0.1)
    found = normal_equations(r, jacobian, common, robust=robust)

    def direct(b: np.ndarray) -> float:
        e = r - common @ b
        return (huber(e) if robust else float(e @ e)) + float(b @ b)

    assert found.cost == pytest.approx(minimize(direct, np.zeros(2), tol=1e-12).fun, rel=1e-8)
    h = 1e-5
    for i in range(3):
        ends = [
            normal_equations(r + sign * h * jacobian[:, i], jacobian, common, robust=robust).cost
            for sign in (1, -1)
        ]
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(2 * found.gradient[i], rel=1e-4)


def test_the_hessian_includes_the_common_error_in_the_covariance() -> None:
    """Without robustness, J' (1 + B B')^-1 J (M. Woodbury 1950)."""
    rng = np.random.default_rng(3)
    jacobian, common = rng.normal(size=(60, 4)), rng.normal(size=(60, 2))
    found = normal_equations(rng.normal(size=60), jacobian, common, robust=False)
    covariance = np.eye(60) + common @ common.T
    assert np.allclose(found.hessian, jacobian.T @ np.linalg.solve(covariance, jacobian))
