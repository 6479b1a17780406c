"""Whole courses in a world in which Laplace's evidence is exact."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import screen
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from tests.workers.diagnosis.linear_world import (
    catalogue,
    effect,
    field_draw,
    layout,
    linear_diagnosis,
    linear_fit,
    mode,
    nominal_problem,
    observed,
    signal_of,
)


def test_screening_expects_the_evidence_of_each_fit():
    rng = np.random.default_rng(51)
    problem = observed(nominal_problem(), rng, signal_of(catalogue()[3], rng))
    effects = catalogue()[:5]
    for one, result in zip(effects, (screen(problem, [e])[0] for e in effects), strict=True):
        gain = linear_fit(problem, [one]).log_evidence(None) - log_evidence(problem)
        assert gain == pytest.approx(result.log_bayes_factor, abs=1e-8)


@pytest.mark.parametrize("index", range(6))
def test_each_strong_effect_is_named(index):
    sensitivity = catalogue()[index]
    signal = -sensitivity.places[-1] @ (2.0 * sensitivity.prior_sd)
    problem = observed(nominal_problem(), np.random.default_rng(52), signal)
    found = linear_diagnosis(problem, catalogue()).verdict
    assert found.kind == "effect"
    assert found.primary == (sensitivity.name,)
    assert not found.something_else_acts


def test_a_pair_of_acting_effects_is_found():
    tilt, stiffening = catalogue()[1], catalogue()[4]
    signal = -0.9 * tilt.columns[:, 0] - 1.1 * stiffening.columns[:, 0]
    problem = observed(nominal_problem(), np.random.default_rng(53), signal)
    found = linear_diagnosis(problem, catalogue())
    assert found.verdict.kind == "effect"
    assert set(found.verdict.primary) == {"tilt", "stiffening"}
    assert found.best is not None
    assert found.gain(found.best.names) > found.verdict.gain + SETTINGS.selection.further


@pytest.mark.parametrize("seen", [(True, True), (True, False), (False, True)])
def test_causes_are_chosen_on_some_of_the_states(seen):
    """An effect that acts in one state only is not chosen on the other."""
    tilt = catalogue()[1]
    rows = np.repeat(seen, 60)
    problem = observed(
        nominal_problem(), np.random.default_rng(59), -1.2 * tilt.columns[:, 0] * rows
    )
    found = linear_diagnosis(problem, catalogue()[:2])
    alone = [found.chosen_on(layout(60)[2] == state) for state in (0, 1)]
    assert [names == ("tilt",) for names in alone] == list(seen)
    assert found.chosen_on(np.ones(120, bool)) == ("tilt",)


def test_evidence_on_some_residuals_is_that_of_these_residuals_alone():
    problem = observed(nominal_problem(), np.random.default_rng(60))
    rows = layout(60)[2] == 1
    alone = replace(
        problem,
        residual=problem.residual[rows],
        nominal=problem.nominal[rows],
        covariance_factor=np.linalg.cholesky(problem.covariance[np.ix_(rows, rows)]),
    )
    assert log_evidence(problem.of(rows)) == pytest.approx(log_evidence(alone), abs=1e-9)
    assert problem.of(np.ones(120, bool)).covariance_factor is problem.covariance_factor


def test_twin_effects_cannot_be_told_apart():
    """Two effects with almost the same columns."""
    tilt = catalogue()[1]
    other = tilt.columns[:, 0] + 0.03 * mode(60, (1, 1, 0), 2, 1.0)
    sensitivities = (*catalogue(), effect("flex", other, 0.5, family="plate geometry"))
    problem = observed(nominal_problem(), np.random.default_rng(54), -0.6 * tilt.columns[:, 0])
    found = linear_diagnosis(problem, sensitivities).verdict
    assert found.kind == "cannot-be-told-apart"
    assert set(found.rivals) == {"tilt", "flex"}
    assert found.primary == found.rivals[:1]


def test_a_smooth_field_without_a_listed_cause_is_none_of_these():
    """Every visible effect has been fitted by then."""
    rng = np.random.default_rng(55)
    kinds = []
    while len(kinds) < 12:
        field = field_draw(60, rng)
        if 0.25 < np.std(field) < 0.6:
            found = linear_diagnosis(observed(nominal_problem(), rng, field), catalogue())
            kinds.append(found.verdict.kind)
            if kinds[-1] == "none-of-these":
                assert {(e.name,) for e in catalogue()} <= set(found.joint_fits)
    assert kinds.count("none-of-these") >= 11


def test_a_force_that_scales_like_a_nominal_parameter_is_hidden():
    force = effect("force", nominal_problem().nominal[:, 1] * 0.8, 0.5)
    problem = observed(
        nominal_problem(), np.random.default_rng(56), signal_of(force, np.random.default_rng(1))
    )
    found = linear_diagnosis(problem, (*catalogue(), force)).verdict
    assert found.hidden == ("force",)
    assert found.kind == "no-gap"


def chi2(problem, effects):
    """Return the least sum of squared whitened residuals, whatever the priors."""
    columns = np.hstack([problem.nominal, *(e.columns for e in effects)])
    A, rho = problem.whiten(columns), problem.whitened_residual
    return float(((rho - A @ np.linalg.lstsq(A, rho, rcond=None)[0]) ** 2).sum())


@dataclass(frozen=True)
class Drawn:
    """A body with or without an acting effect, and the effects that come first.

    `loudest` and `closest` are the effect with the largest evidence and with the least chi2, each
    with its gain in nats over the nominal model.
    """

    acting: str | None
    named: tuple[str, ...]
    loudest: tuple[str, float]
    closest: tuple[str, float]


def drawn(acting, rng):
    effects = catalogue()[:5]
    signal = np.zeros(120) if acting is None else signal_of(acting, rng)
    problem = observed(nominal_problem(), rng, signal)
    falls = {e.name: (chi2(problem, []) - chi2(problem, [e])) / 2 for e in effects}
    closest = max(falls.items(), key=lambda fall: fall[1])
    first = screen(problem, effects)[0]
    loudest = first.name, first.log_bayes_factor
    named = linear_diagnosis(problem, effects).verdict.primary
    return Drawn(None if acting is None else acting.name, named, loudest, closest)


@pytest.fixture(scope="module")
def acting():
    """Return 120 bodies on which each of five effects acts in turn, as large as its prior."""
    rng = np.random.default_rng(57)
    return [drawn(catalogue()[number % 5], rng) for number in range(120)]


@pytest.fixture(scope="module")
def null():
    rng = np.random.default_rng(58)
    return [drawn(None, rng) for _ in range(120)]


def test_the_largest_evidence_is_right_at_least_as_often_as_the_least_chi2(acting):
    """The chi2 prefers effects with more parameters and with wider priors."""
    loudest = sum(body.loudest[0] == body.acting for body in acting)
    closest = sum(body.closest[0] == body.acting for body in acting)
    assert loudest >= closest
    assert loudest > 100


def test_at_equal_alarms_the_evidence_names_at_least_as_many(acting, null):
    """Each method names an effect that gains more than it does on any body without one."""
    least_loud, least_close = (
        max(getattr(body, method)[1] for body in null) for method in ("loudest", "closest")
    )
    assert least_loud < least_close
    loudest = sum(b.loudest[0] == b.acting and b.loudest[1] > least_loud for b in acting)
    closest = sum(b.closest[0] == b.acting and b.closest[1] > least_close for b in acting)
    assert loudest >= closest


def test_the_rule_names_the_right_effect_and_raises_no_alarm(acting, null):
    """Effects that it does not name are small: their gain is less than the least gain."""
    assert not any(body.named for body in null)
    right = sum(body.named[:1] == (body.acting,) for body in acting)
    assert right >= 80
    assert sum(bool(body.named) for body in acting) - right <= 1
    for body in acting:
        assert bool(body.named) == (body.loudest[1] > SETTINGS.selection.first)
