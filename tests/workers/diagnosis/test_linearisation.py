"""The projection, compared with the covariance that it inverts."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.linearisation import Linearised, factored
from tests.workers.diagnosis.linear_world import nominal_problem, observed


def test_projection_is_the_marginal_precision():
    """P = (I + A S A')^-1, here inverted as a dense matrix."""
    problem = nominal_problem()
    A = np.linalg.solve(problem.covariance_factor, problem.nominal)
    dense = np.linalg.inv(np.eye(problem.size) + (A * problem.nominal_sd**2) @ A.T)
    assert problem.project(np.eye(problem.size)) == pytest.approx(dense, abs=1e-11)


def test_flat_priors_give_the_orthogonal_projector():
    problem = replace(nominal_problem(), nominal_sd=np.full(3, 1e5))
    A = problem.whiten(problem.nominal)
    v = np.random.default_rng(1).standard_normal(problem.size)
    once = problem.project(v)
    assert A.T @ once == pytest.approx(0.0, abs=1e-6)
    assert problem.project(once) == pytest.approx(once, abs=1e-6)


def test_converged_fit_needs_no_projection():
    """At the maximum of the posterior the gradient is zero, so P (rho - A offset) = rho."""
    problem = observed(nominal_problem(), np.random.default_rng(2))
    A, rho = problem.scaled_nominal, problem.whitened_residual
    step = -np.linalg.solve(np.eye(3) + A.T @ A, A.T @ rho)
    change = step * problem.nominal_sd
    there = replace(
        problem, residual=problem.residual + problem.nominal @ change, nominal_offset=change
    )
    assert there.efficient_residual == pytest.approx(there.whitened_residual, abs=1e-10)
    assert there.efficient_residual == pytest.approx(problem.efficient_residual, abs=1e-10)


def test_rejects_invalid_input():
    good = nominal_problem()
    with pytest.raises(InputError, match=r"nominal must be .*\(120, 3\)"):
        replace(good, nominal=good.nominal[:, :2])
    with pytest.raises(InputError, match="with 1 non-finite numbers"):
        replace(good, residual=np.append(np.nan, good.residual[1:]))
    with pytest.raises(InputError, match="nominal_sd must be > 0"):
        replace(good, nominal_sd=np.array([1.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="positive diagonal"):
        Linearised(np.zeros(2), np.zeros((2, 0)), np.zeros(0), np.zeros(0), -np.eye(2))
    with pytest.raises(InputError, match="not positive definite"):
        factored(np.ones((2, 2)))
