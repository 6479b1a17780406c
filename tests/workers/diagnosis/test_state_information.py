"""Information in a set of states, and in a further state."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.workers.diagnosis.expected_information import detectability, separation
from palpate.workers.diagnosis.fits.effect_screening import confusion, minimum_detectable
from palpate.workers.diagnosis.linearisation import Linearised, factored
from tests.workers.diagnosis.linear_world import (
    catalogue,
    effect,
    layout,
    mode,
    nominal_problem,
    observed,
)

LOW = layout(60)[2] == 0


def of_states(problem, sensitivities, rows):
    """Return the problem with the residuals of a subset of states."""
    smaller = Linearised(
        problem.residual[rows],
        problem.nominal[rows],
        problem.nominal_sd,
        problem.nominal_offset,
        factored(problem.covariance[np.ix_(rows, rows)]),
    )
    return smaller, [replace(f, columns=f.columns[..., rows, :]) for f in sensitivities]


def rows_of(problem, sensitivities):
    """Return the detectability of each effect."""
    return detectability(problem, sensitivities, confusion(problem, sensitivities))


def test_another_state_never_lowers_the_information():
    """Minimum magnitudes never rise."""
    whole = nominal_problem()
    smaller, fewer = of_states(whole, catalogue(), LOW)
    for before, after in zip(fewer, catalogue(), strict=True):
        one = minimum_detectable(smaller, before)
        assert (minimum_detectable(whole, after) <= one * (1 + 1e-9)).all()
    rows = rows_of(whole, catalogue())
    assert [row.name for row in rows] == [f.name for f in catalogue()]
    assert rows[1].minimum == pytest.approx(minimum_detectable(whole, catalogue()[1]))


def test_the_most_similar_effect_is_named():
    tilt = catalogue()[1]
    twin = effect("twin", 2.0 * tilt.columns)
    row = rows_of(nominal_problem(), (*catalogue(), twin))[1]
    assert row.nearest == "twin"
    assert row.cosine == pytest.approx(1.0)
    alone = rows_of(nominal_problem(), [tilt])[0]
    assert alone.nearest is None


def test_separation_does_not_depend_on_the_residuals():
    rng = np.random.default_rng(61)
    seen = observed(nominal_problem(), rng, 3.0)
    here, there = (separation(p, catalogue()[:5]) for p in (seen, nominal_problem()))
    assert (here == there).all()


def test_separation_is_the_divergence_of_dense_normals():
    """The normals describe the residuals that two effects predict, with dense covariances."""
    problem = nominal_problem()
    base = problem.covariance + (problem.nominal * problem.nominal_sd**2) @ problem.nominal.T
    effects = catalogue()[:5]
    dense = [base + (f.columns * f.prior_sd**2) @ f.columns.T for f in effects]
    logs = [np.linalg.slogdet(S)[1] for S in dense]
    expected = [
        [
            0.5 * (np.trace(np.linalg.solve(Sj, Sk)) - problem.size + lj - lk)
            for Sj, lj in zip(dense, logs, strict=True)
        ]
        for Sk, lk in zip(dense, logs, strict=True)
    ]
    assert separation(problem, effects) == pytest.approx(np.array(expected), abs=1e-8)


def test_separation_uses_the_best_place_of_the_rival():
    """It is the median over the places of the acting effect, against the rival's best place."""
    problem, (*_, inclusion) = nominal_problem(), catalogue()
    tilt = catalogue()[1]
    found = separation(problem, [inclusion, tilt])
    spots = [effect(str(i), columns) for i, columns in enumerate(inclusion.columns)]
    each = separation(problem, [*spots, tilt])
    assert found[0, 1] == pytest.approx(np.median(each[:4, 4]))
    assert found[1, 0] == pytest.approx(each[4, :4].min())


def test_identical_effects_are_not_separated():
    tilt = catalogue()[1]
    found = separation(nominal_problem(), [tilt, replace(tilt, name="twin")])
    assert found == pytest.approx(np.zeros((2, 2)), abs=1e-9)


def test_a_second_load_separates_effects_identical_at_the_first():
    """Two effects are identical at the low load and differ only at the high load."""
    low = of_states(nominal_problem(), catalogue(), LOW)[0]
    shape = mode(60, (0, 1, 1), 0, 1.0)
    stiff = mode(60, (0, 1, 1), 0, 4.0) * (0.6 / 0.6**4)
    pair = [effect("linear", shape[LOW]), effect("stiffening", stiff[LOW])]
    assert separation(low, pair) == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    whole = [effect("linear", shape), effect("stiffening", stiff)]
    assert separation(nominal_problem(), whole)[0, 1] > 1.0
