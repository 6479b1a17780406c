"""Evidence, compared with densities and integrals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from palpate.workers.diagnosis.laplace_evidence import (
    Quadratic,
    log_evidence,
    log_marginal,
    log_orthant,
)
from tests.workers.diagnosis.linear_world import (
    dense_log_density,
    effect,
    mode,
    nominal_problem,
    observed,
)


def moved(problem, step):
    """Return the same problem, linearised at another point."""
    return replace(
        problem,
        residual=problem.residual + problem.nominal @ step,
        nominal_offset=problem.nominal_offset + step,
    )


def test_evidence_equals_the_normal_density():
    problem = observed(nominal_problem(), np.random.default_rng(3))
    assert log_evidence(problem) == pytest.approx(dense_log_density(problem), abs=1e-8)


def test_evidence_does_not_depend_on_the_expansion_point():
    problem = observed(nominal_problem(), np.random.default_rng(4))
    sided = np.array([False, True, True])
    there = moved(problem, np.array([0.3, 1.7, 0.4]))
    assert log_evidence(there) == pytest.approx(log_evidence(problem), abs=1e-8)
    assert log_evidence(there, sided) == pytest.approx(log_evidence(problem, sided), abs=1e-8)


@pytest.mark.parametrize("strength", [-2.0, -0.3, 0.0, 0.3, 2.0])
def test_one_sided_parameter_matches_an_integral(strength):
    """The likelihood times a half-normal prior is integrated by quadrature, also at the bound."""
    shape = mode(60, (2, 0, 0), 1, 1.5)
    sd = 0.7
    problem = observed(nominal_problem(), np.random.default_rng(5), -strength * shape)
    top = max(dense_log_density(moved_by(problem, shape, t)) for t in np.linspace(0, 3, 40))

    def integrand(t):
        prior = 2 * norm.pdf(t, scale=sd)
        return prior * np.exp(dense_log_density(moved_by(problem, shape, t)) - top)

    direct = np.log(quad(integrand, 0, 5, limit=200, points=[0.1, 0.5, 2.0])[0]) + top
    freed = problem.freed(shape[:, None], np.array([sd]))
    found = log_evidence(freed, np.array([False, False, False, True]))
    assert found == pytest.approx(direct, abs=1e-6)


@pytest.mark.parametrize("strength", [-2.0, 0.0, 0.4, 2.0])
@pytest.mark.parametrize(("bound", "inward"), [(0.3, -1), (-0.3, 1)])
def test_a_parameter_at_its_bound_matches_an_integral(strength, bound, inward):
    """Values beyond a bound at which a fit stopped do not count, near the bound or far from it."""
    shape, sd = mode(60, (2, 0, 0), 1, 1.5), 0.7
    problem = observed(nominal_problem(), np.random.default_rng(5), -strength * shape)
    within = sorted([bound, bound + inward * 6.0])
    top = max(dense_log_density(moved_by(problem, shape, t)) for t in np.linspace(*within, 90))

    def integrand(t):
        return norm.pdf(t, scale=sd) * np.exp(dense_log_density(moved_by(problem, shape, t)) - top)

    near = [bound + inward * away for away in (0.02, 0.1, 0.4, 1.0, 2.0)]
    direct = np.log(quad(integrand, *within, limit=300, points=near)[0]) + top
    freed = problem.freed(shape[:, None], np.array([sd]))
    there = moved(freed, np.array([0.0, 0.0, 0.0, bound]))
    found = log_evidence(there, at_bound=np.array([0, 0, 0, inward]))
    assert found == pytest.approx(direct, abs=1e-6)


def moved_by(problem, shape, t):
    return replace(problem, residual=problem.residual + t * shape)


def test_a_parameter_without_effect_costs_nothing():
    """Its posterior is its prior, so the evidence with and without it is the same."""
    problem = observed(nominal_problem(), np.random.default_rng(6))
    idle = problem.freed(np.zeros((problem.size, 2)), np.array([0.3, 5.0]))
    sided = np.array([False, False, False, True, True])
    assert log_evidence(idle) == pytest.approx(log_evidence(problem), abs=1e-10)
    assert log_evidence(idle, sided) == pytest.approx(log_evidence(problem), abs=1e-10)


@pytest.mark.parametrize("x", [-30.0, -3.0, 0.0, 2.0])
def test_one_dimensional_orthant_is_the_normal_distribution(x):
    found = log_orthant(np.array([[x]]), np.array([[4.0]]))[0]
    assert found == pytest.approx(norm.logcdf(x / 2), rel=1e-12)


@pytest.mark.parametrize("rho", [-0.9, -0.3, 0.0, 0.5, 0.95])
def test_orthant_probability_in_two_and_three_dimensions(rho):
    """Sheppard: 1/4 + asin(rho) / 2 pi; for three equal variables 1/8 + 3 asin(rho) / 4 pi."""
    two = np.array([[1.0, rho], [rho, 1.0]])
    expected = np.log(0.25 + np.arcsin(rho) / (2 * np.pi))
    assert log_orthant(np.zeros(2), two) == pytest.approx(expected, abs=2e-3)
    if rho > -0.5:
        three = np.full((3, 3), rho) + (1 - rho) * np.eye(3)
        expected = np.log(0.125 + 3 * np.arcsin(rho) / (4 * np.pi))
        assert log_orthant(np.zeros(3), three) == pytest.approx(expected, abs=1e-2)


def test_orthant_probability_is_accurate_in_far_tails():
    """For independent variables it is a product, here for several means at once."""
    mean = np.array([[-12.0, 1.0], [-9.0, -20.0]])
    expected = norm.logcdf(mean).sum(axis=0)
    assert log_orthant(mean.T, np.eye(2)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("sided", [(), (1,), (0, 3)])
def test_a_stack_equals_its_elements(sided):
    """Twelve misfits of five parameters, with one-sided parameters in any position."""
    rng = np.random.default_rng(8)
    A, rho = rng.standard_normal((3, 4, 9, 5)), rng.standard_normal((3, 4, 9))
    offset, one_sided = rng.standard_normal(5), np.isin(np.arange(5), sided)
    each = [
        Quadratic(np.array(r @ r), B.T @ r, B.T @ B)
        for B, r in zip(A.reshape(12, 9, 5), rho.reshape(12, 9), strict=True)
    ]
    stack = Quadratic(
        np.einsum("ijm,ijm->ij", rho, rho),
        np.einsum("ijmp,ijm->ijp", A, rho),
        np.einsum("ijmp,ijmq->ijpq", A, A),
    )
    found = log_marginal(stack, offset, one_sided)
    assert found.shape == (3, 4)
    alone = [float(log_marginal(one, offset, one_sided)) for one in each]
    assert found.ravel() == pytest.approx(alone, rel=1e-10)


def test_simpler_hypothesis_wins_if_true():
    """It wins by the prior width that the larger hypothesis wastes."""
    rng = np.random.default_rng(7)
    shape = effect("tilt", mode(60, (0, 1, 1), 0, 1.0)).columns
    gains = []
    for _ in range(200):
        problem = observed(nominal_problem(), rng)
        gains.append(log_evidence(problem.freed(shape, np.ones(1))) - log_evidence(problem))
    B = nominal_problem().whiten(shape)
    information = (B.T @ nominal_problem().project(B)).item()
    # E of (g^2 / H - ln H) / 2 with g^2 ~ information * chi2_1 and H = information + 1.
    expected = 0.5 * (information / (information + 1) - np.log(information + 1))
    error = np.std(gains) / np.sqrt(len(gains))
    assert np.mean(gains) == pytest.approx(expected, abs=4 * error)
