"""What further scans add, against problems that were built whole."""

from dataclasses import replace

import numpy as np
import pytest
from linear_world import (
    catalogue,
    effect,
    layout,
    mode,
    nominal_problem,
    observed,
)

from storage.errors import InputError
from workers.diagnosis.detectability import minimum_detectable
from workers.planning.states import (
    NewStates,
    detectability,
    extended,
    next_scan,
    of_states,
    separation,
)

LOW = layout(60)[2] == 0


def high_state(fingerprints):
    """The second state of the world, as one that is not scanned yet."""
    problem = nominal_problem()
    C = problem.covariance
    return NewStates(
        problem.nominal[~LOW],
        {f.name: f.columns[..., ~LOW, :] for f in fingerprints},
        C[np.ix_(~LOW, ~LOW)],
        C[np.ix_(~LOW, LOW)],
    )


def test_a_state_taken_off_and_put_back():
    whole = nominal_problem()
    smaller, fewer = of_states(whole, catalogue(), LOW)
    again, effects = extended(smaller, fewer, high_state(catalogue()))
    assert again.covariance_factor == pytest.approx(whole.covariance_factor, abs=1e-12)
    assert (again.nominal == whole.nominal).all()
    for found, expected in zip(effects, catalogue(), strict=True):
        assert (found.columns == expected.columns).all()


def test_another_state_never_hides_anything():
    """Information only grows: every minimum falls or stays."""
    whole = nominal_problem()
    smaller, fewer = of_states(whole, catalogue(), LOW)
    for before, after in zip(fewer, catalogue(), strict=True):
        one = minimum_detectable(smaller, before)
        assert (minimum_detectable(whole, after) <= one * (1 + 1e-9)).all()
    rows = detectability(whole, catalogue())
    assert [row.name for row in rows] == [f.name for f in catalogue()]
    assert rows[1].minimum == pytest.approx(minimum_detectable(whole, catalogue()[1]))


def test_the_nearest_relative_is_named():
    tilt = catalogue()[1]
    twin = effect("twin", 2.0 * tilt.columns)
    row = detectability(nominal_problem(), (*catalogue(), twin))[1]
    assert row.nearest == "twin"
    assert row.cosine == pytest.approx(1.0)
    alone = detectability(nominal_problem(), [tilt])[0]
    assert alone.nearest is None


def test_residuals_do_not_matter():
    rng = np.random.default_rng(61)
    seen = observed(nominal_problem(), rng, 3.0)
    here, there = (separation(p, catalogue()[:5]) for p in (seen, nominal_problem()))
    assert (here == there).all()


def test_separation_is_the_divergence_of_dense_normals():
    """Of the residuals that two effects predict, with all covariances written out."""
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


def test_separation_counts_the_worst_places():
    """The median over the places of the acting effect, against the best place of its rival."""
    problem, (*_, inclusion) = nominal_problem(), catalogue()
    tilt = catalogue()[1]
    found = separation(problem, [inclusion, tilt])
    spots = [effect(str(i), columns) for i, columns in enumerate(inclusion.columns)]
    each = separation(problem, [*spots, tilt])
    assert found[0, 1] == pytest.approx(np.median(each[:4, 4]))
    assert found[1, 0] == pytest.approx(each[4, :4].min())


def test_twins_are_not_separated():
    tilt = catalogue()[1]
    found = separation(nominal_problem(), [tilt, replace(tilt, name="twin")])
    assert found == pytest.approx(np.zeros((2, 2)), abs=1e-9)


def test_the_next_scan_is_the_one_that_separates():
    """Two effects are one and the same at the low load; they differ at the high one only."""
    low = of_states(nominal_problem(), catalogue(), LOW)[0]
    shape = mode(60, (0, 1, 1), 0, 1.0)
    stiff = mode(60, (0, 1, 1), 0, 4.0) * (0.6 / 0.6**4)
    pair = [effect("linear", shape[LOW]), effect("stiffening", stiff[LOW])]
    assert separation(low, pair) == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    whole = [effect("linear", shape), effect("stiffening", stiff)]
    second = high_state(whole)
    C = nominal_problem().covariance
    repeat = NewStates(
        low.nominal,
        {f.name: f.columns for f in pair},
        C[np.ix_(LOW, LOW)],
        C[np.ix_(~LOW, LOW)],
    )
    found = next_scan(low, pair, {"linear", "stiffening"}, {"repeat": repeat, "second": second})
    assert list(found) == ["second", "repeat"]
    assert found["repeat"] == pytest.approx(0.0, abs=1e-9)
    assert found["second"] == pytest.approx(separation(nominal_problem(), whole)[0, 1], rel=0.9)
    assert found["second"] > 1.0


def test_wrong_input_is_named():
    problem = nominal_problem()
    with pytest.raises(InputError, match="Name two or more"):
        next_scan(problem, catalogue(), {"tilt"}, {})
    with pytest.raises(InputError, match="no columns of \\['friction'"):
        extended(problem, catalogue()[2:], high_state(catalogue()[:2]))
    with pytest.raises(InputError, match="Choose some"):
        of_states(problem, catalogue(), np.zeros(120, dtype=bool))
