"""Screening, compared with ridge regression, densities and integrals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import subspace_angles
from scipy.special import logsumexp
from scipy.stats import norm

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.fits.effect_screening import (
    absorbed_share,
    confusion,
    hides,
    minimum_detectable,
    screen,
)
from tests.workers.diagnosis.linear_world import (
    catalogue,
    dense_log_density,
    effect,
    mode,
    nominal_problem,
    observed,
    signal_of,
)


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(11)
    return observed(nominal_problem(), rng, signal_of(catalogue()[0], rng))


def one(problem, sensitivity):
    return screen(problem, [sensitivity])[0]


@pytest.mark.parametrize("index", [0, 1, 3, 4])
def test_estimate_equals_ridge_regression(problem, index):
    """All parameters are fitted by generalised least squares, with the priors as ridge."""
    sensitivity = catalogue()[index]
    J = np.hstack([problem.nominal, sensitivity.columns])
    sd = np.append(problem.nominal_sd, sensitivity.prior_sd)
    weight = np.linalg.inv(problem.covariance)
    H = J.T @ weight @ J + np.diag(sd**-2.0)
    solution = -np.linalg.solve(H, J.T @ weight @ problem.residual)
    result = one(problem, sensitivity)
    assert result.estimate == pytest.approx(solution[3:], rel=1e-7)
    assert result.estimate_sd == pytest.approx(np.sqrt(np.diag(np.linalg.inv(H)))[3:], rel=1e-7)


@pytest.mark.parametrize("index", [0, 1, 3, 4])
def test_bayes_factor_is_a_ratio_of_densities(problem, index):
    sensitivity = catalogue()[index]
    with_it = dense_log_density(problem, sensitivity.columns, sensitivity.prior_sd)
    expected = with_it - dense_log_density(problem)
    assert one(problem, sensitivity).log_bayes_factor == pytest.approx(expected, abs=1e-8)


def test_bayes_factor_does_not_depend_on_the_expansion(problem):
    step = np.array([0.2, -0.6, 1.1])
    there = replace(
        problem, residual=problem.residual + problem.nominal @ step, nominal_offset=step
    )
    here = {f.name: f.log_bayes_factor for f in screen(problem, catalogue())}
    moved = {f.name: f.log_bayes_factor for f in screen(there, catalogue())}
    assert moved == pytest.approx(here, abs=1e-8)


@pytest.mark.parametrize("strength", [-0.5, 0.0, 0.5])
def test_one_sided_bayes_factor_matches_an_integral(strength):
    sensitivity = catalogue()[2]
    column = sensitivity.columns[:, 0]
    problem = observed(nominal_problem(), np.random.default_rng(12), -strength * column)
    base = dense_log_density(problem)

    def integrand(t):
        ahead = replace(problem, residual=problem.residual + t * column)
        return 2 * norm.pdf(t, scale=0.5) * np.exp(dense_log_density(ahead) - base)

    direct = np.log(quad(integrand, 0, 4, limit=200, points=[0.2, 0.5, 1.0])[0])
    assert one(problem, sensitivity).log_bayes_factor == pytest.approx(direct, abs=1e-5)


def test_bayes_factor_is_averaged_over_places(problem):
    sensitivity = catalogue()[5]
    each = [
        dense_log_density(problem, columns, sensitivity.prior_sd) - dense_log_density(problem)
        for columns in sensitivity.columns
    ]
    result = one(problem, sensitivity)
    assert result.place_log_bayes_factors == pytest.approx(each, abs=1e-8)
    assert result.place == int(np.argmax(each))
    expected = logsumexp(each) - np.log(4)
    assert result.log_bayes_factor == pytest.approx(expected, abs=1e-8)


def test_the_acting_effect_comes_first(problem):
    screening = screen(problem, catalogue())
    assert screening[0].name == "gravity"
    assert screening[0].score > 2 * screening[1].score


def test_a_combination_of_nominal_columns_is_absorbed():
    """With wide priors it is fully absorbed; a field outside the columns' span is not."""
    problem = replace(nominal_problem(), nominal_sd=np.full(3, 1e4))
    within = problem.nominal @ np.array([[1.0], [-0.3], [0.2]])
    assert absorbed_share(problem, effect("within", within).whitened(problem)[0]) > 1 - 1e-6
    A = problem.whiten(problem.nominal)
    v = np.random.default_rng(13).standard_normal((problem.size, 1))
    outside = v - A @ np.linalg.lstsq(A, v, rcond=None)[0]
    assert absorbed_share(problem, outside) == pytest.approx(0.0, abs=1e-12)
    half = outside / np.linalg.norm(outside) + A[:, :1] / np.linalg.norm(A[:, 0])
    assert absorbed_share(problem, half) == pytest.approx(0.5, abs=1e-6)
    assert absorbed_share(problem, np.zeros((problem.size, 1))) == 1.0


def test_minimum_detectable_magnitude_is_found_in_four_of_five_cases():
    """The test is a two-sided z test at 1 % on the generalised least squares estimate."""
    problem = replace(nominal_problem(), nominal_sd=np.full(3, 1e4))
    sensitivity = catalogue()[1]
    magnitude = minimum_detectable(problem, sensitivity)[0]
    J = np.hstack([problem.nominal, sensitivity.columns])
    weight = np.linalg.inv(problem.covariance)
    covariance = np.linalg.inv(J.T @ weight @ J)
    rng = np.random.default_rng(14)
    noise = problem.covariance_factor @ rng.standard_normal((problem.size, 4000))
    r = -magnitude * sensitivity.columns + noise
    z = -(covariance @ J.T @ weight @ r)[3] / np.sqrt(covariance[3, 3])
    assert np.mean(np.abs(z) > norm.ppf(0.995)) == pytest.approx(0.8, abs=0.025)


def test_confusion_is_the_smallest_principal_angle():
    problem = nominal_problem()
    effects = catalogue()[:5]
    projected = [problem.project(problem.whiten(f.columns)) for f in effects]
    cosines = confusion(problem, effects)
    for i, first in enumerate(projected):
        for j, second in enumerate(projected):
            expected = np.cos(subspace_angles(first, second).min())
            assert cosines[i, j] == pytest.approx(expected, abs=1e-9)


def test_confusion_is_the_largest_over_places():
    problem = nominal_problem()
    bump = catalogue()[5]
    twin = effect("twin", bump.columns[2])
    assert confusion(problem, [twin, bump])[0, 1] == pytest.approx(1.0)


def test_invisible_effects_have_no_confusion():
    problem = replace(nominal_problem(), nominal_sd=np.full(3, 1e7))
    hidden = effect("hidden", problem.nominal[:, 0])
    assert confusion(problem, [hidden, catalogue()[1]])[0, 1] == 0.0


def test_refuses_sensitivities_at_other_points(problem):
    with pytest.raises(InputError, match=r"tilt has columns for 40 residuals.*has 120"):
        screen(problem, [effect("tilt", mode(20, (0, 1, 1), 0, 1.0))])
    with pytest.raises(InputError, match="prior_sd > 0"):
        effect("tilt", mode(20, (0, 1, 1), 0, 1.0), sd=0.0)


def test_strong_effects_are_visible_despite_absorption():
    """A thirtieth of the square is hidden at 0.1 mm but not at 100 mm; a hundredth always is."""
    problem = nominal_problem()
    within = problem.nominal[:, 0] / np.linalg.norm(problem.nominal[:, 0])
    left = problem.covariance_factor @ problem.project(problem.whiten(mode(60, (0, 1, 1), 0, 1.0)))
    left *= np.linalg.norm(problem.whiten(within)) / np.linalg.norm(problem.whiten(left))
    for part, size, hidden in ((30, 0.1, True), (30, 100.0, False), (100, 100.0, True)):
        column = effect("alike", size * (within + left / np.sqrt(part))).whitened(problem)[0]
        assert 1 - absorbed_share(problem, column) == pytest.approx(1 / part, rel=0.1)
        assert hides(problem, column) is hidden
    assert not hides(problem, problem.project(effect("seen", 0.01 * left).whitened(problem)[0]))
