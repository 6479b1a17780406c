"""The gap compared with noise-free truth: it is unbiased, and its intervals cover the truth."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.linearisation import LinearFit
from palpate.workers.diagnosis.outcome import gap_and_shrinkage as shrinkages
from palpate.workers.diagnosis.outcome.gap_and_shrinkage import (
    Comparison,
    Gap,
    credited,
    gap,
    pooled,
)
from palpate.workers.mechanics.effects.observation_effects import rigid_columns
from tests.workers.diagnosis.linear_world import catalogue, layout, mode, nominal_problem, observed

STATE = layout(60)[2]
LOW, HIGH = STATE == 0, STATE == 1
REPLICATES = 300


def known_gap():
    """Return the residual of an effect of 0.25 mm and a remainder of 0.12 mm of another shape."""
    return -0.25 * catalogue()[1].columns[:, 0] - 0.12 * mode(60, (1, 2, 0), 2, 1.0)


def replicate(problem, truth, rng, train=None, judge=None):
    """Return a fit to a new image, and the squared gap that it really leaves."""
    noise = problem.covariance_factor @ rng.standard_normal(problem.size)
    fit = LinearFit(replace(problem, residual=truth + noise), train, judge)
    step = fit.step * problem.nominal_sd
    rows = slice(None) if judge is None else judge
    return fit, ((truth + problem.nominal @ step)[rows] ** 2).mean()


@pytest.mark.parametrize(
    ("train", "judge"),
    [(None, None), (None, HIGH), (LOW, HIGH), (HIGH, LOW)],
    ids=["in-sample", "one state", "held-out high", "held-out low"],
)
@pytest.mark.parametrize("size", [0.0, 1.0])
def test_excess_is_unbiased(train, judge, size):
    """The mean of the estimate minus the truth is within four standard errors of zero."""
    rng = np.random.default_rng(31)
    errors = []
    for _ in range(REPLICATES):
        fit, true = replicate(nominal_problem(), size * known_gap(), rng, train, judge)
        errors.append(fit.excess_mm2 - true)
    assert np.mean(errors) == pytest.approx(0.0, abs=4 * np.std(errors) / np.sqrt(REPLICATES))


def test_plain_excess_over_noise_would_be_too_small():
    """The noise absorbed by the fit is not small, so without the penalty there is a bias."""
    rng = np.random.default_rng(32)
    plain, penalised = [], []
    for _ in range(REPLICATES):
        fit, true = replicate(nominal_problem(), known_gap(), rng)
        plain.append((fit.residual**2).mean() - fit.observation_mm2.mean() - true)
        penalised.append(fit.excess_mm2 - true)
    error = np.std(plain) / np.sqrt(REPLICATES)
    assert np.mean(plain) < -4 * error
    assert abs(np.mean(penalised)) < 4 * error


@pytest.mark.parametrize(("train", "judge"), [(None, None), (LOW, HIGH)])
def test_interval_covers_the_gap(train, judge):
    """Coverage is within 0.05 of 90 % (the estimate is skewed, the interval symmetric)."""
    rng = np.random.default_rng(33)
    held = []
    for _ in range(REPLICATES):
        fit, true = replicate(nominal_problem(), known_gap(), rng, train, judge)
        found = gap(fit)
        held.append(found.low_mm <= np.sqrt(true) <= found.high_mm)
    assert np.mean(held) == pytest.approx(0.9, abs=0.05)


def test_standard_deviation_matches_simulation():
    """The formula for the mean square, evaluated with the true mean, is checked by simulation."""
    problem, truth = nominal_problem(), known_gap()
    fit = LinearFit(problem)
    rng = np.random.default_rng(34)
    noise = problem.covariance_factor @ rng.standard_normal((problem.size, 4000))
    squares = (fit.after(truth[:, None] + noise) ** 2).sum(axis=0)
    m, D = fit.after(truth[:, None])[:, 0], fit.covariance
    assert np.var(squares) == pytest.approx(2 * np.sum(D**2) + 4 * m @ D @ m, rel=0.08)


@pytest.mark.parametrize("train", [None, LOW])
def test_noise_after_a_fit_equals_a_dense_map(train):
    """The dense map is (I + F) C (I + F)', with F found by fitting unit residuals one by one."""
    problem = nominal_problem()
    fit = LinearFit(problem, train)
    m, C = problem.size, problem.covariance
    F = fit.after(np.eye(m)) - np.eye(m)
    assert fit.covariance == pytest.approx((np.eye(m) + F) @ C @ (np.eye(m) + F).T, abs=1e-12)
    assert fit.noise_mm2 == pytest.approx(np.diag(C + 2 * F @ C), abs=1e-12)
    assert fit.floor_mm == pytest.approx(np.sqrt(np.trace(F @ C @ F.T) / m), rel=1e-9)


def test_fit_is_the_generalised_least_squares_solution():
    problem = observed(nominal_problem(), np.random.default_rng(35))
    problem = replace(problem, nominal_offset=np.array([0.1, -0.4, 0.3]))
    weight = np.linalg.inv(problem.covariance[np.ix_(LOW, LOW)])
    J, prior = problem.nominal[LOW], np.diag(problem.nominal_sd**-2.0)
    gradient = J.T @ weight @ problem.residual[LOW] + prior @ problem.nominal_offset
    step = -np.linalg.solve(J.T @ weight @ J + prior, gradient)
    fit = LinearFit(problem, LOW, HIGH)
    assert fit.step * problem.nominal_sd == pytest.approx(step, rel=1e-8)
    expected = problem.residual[HIGH] + problem.nominal[HIGH] @ step
    assert fit.residual == pytest.approx(expected, abs=1e-10)


def test_excesses_of_subsets_add_up():
    fit = LinearFit(observed(nominal_problem(), np.random.default_rng(37), known_gap()))
    parts = {"low": gap(fit, LOW), "high": gap(fit, HIGH)}
    mean = (parts["low"].excess_mm2 + parts["high"].excess_mm2) / 2
    assert mean == pytest.approx(gap(fit).excess_mm2, rel=1e-10)
    assert parts["low"].points == 60


def test_parts_are_pooled_into_the_whole():
    """The mean square agrees exactly; its error does not shrink, as parts share their errors."""
    fit = LinearFit(observed(nominal_problem(), np.random.default_rng(37), known_gap()))
    whole, both = gap(fit), pooled([gap(fit, LOW), gap(fit, HIGH)])
    assert both.gap_mm == pytest.approx(whole.gap_mm, rel=1e-10)
    assert both.noise_mm == pytest.approx(whole.noise_mm, rel=1e-10)
    assert both.points == whole.points
    assert both.sd_mm2 >= whole.sd_mm2
    assert both.high_mm >= whole.high_mm
    assert both.low_mm <= whole.low_mm


@pytest.mark.parametrize(("deviations", "part"), [(-1.0, 0.0), (2.0, 0.5), (6.0, 0.9)])
def test_an_excess_that_may_be_chance_is_credited_in_part(deviations, part):
    """Calculated by hand: 4 / (4 + 4) for two deviations, 36 / (36 + 4) for six."""
    some = Gap(0.0, 0.0, 0.0, 0.0, sd_mm2=0.003, noise_mm=0.0, points=9)
    excess = deviations * some.sd_mm2
    assert credited(excess, some, 0.1) == pytest.approx(part * max(excess, 0.0))
    assert credited(excess, some, 0.0) == max(excess, 0.0)


def test_gap_and_interval_include_the_floor():
    fit = LinearFit(observed(nominal_problem(), np.random.default_rng(38), known_gap()))
    found = gap(fit, floor_mm=0.08)
    noise = SETTINGS.gap.noise_variance_sd * found.noise_mm**2
    square = found.excess_mm2**3 / (found.excess_mm2**2 + 4 * (found.sd_mm2**2 + noise**2))
    assert found.gap_mm == pytest.approx(np.hypot(np.sqrt(square), 0.08))
    reach = 1.6449 * np.hypot(found.sd_mm2, noise)
    least, most = SETTINGS.gap.floor_range
    low, high = max(0.0, square - reach), found.excess_mm2 + reach
    assert found.low_mm == pytest.approx(np.hypot(np.sqrt(low), least * 0.08), rel=1e-4)
    assert found.high_mm == pytest.approx(np.hypot(np.sqrt(high), most * 0.08), rel=1e-4)


def test_true_model_gap_is_close_to_the_floor():
    """Only the floor is left, so the gap is closer to it than to the residue of noise alone."""
    rng = np.random.default_rng(46)
    fits = [LinearFit(observed(nominal_problem(), rng)) for _ in range(60)]
    floor_mm = 0.1
    plain = [np.hypot(gap(fit).gap_mm, floor_mm) - floor_mm for fit in fits]
    found = [gap(fit, floor_mm=floor_mm).gap_mm - floor_mm for fit in fits]
    assert 0 < np.mean(found) < 0.4 * np.mean(plain)


def both(rng, size=1.0):
    """Return fits without and with the effect to an image with the effect and a remainder."""
    problem = observed(nominal_problem(), rng, size * known_gap())
    return problem, problem.freed(catalogue()[1].columns, catalogue()[1].prior_sd)


@pytest.mark.parametrize(("train", "judge"), [(None, None), (LOW, HIGH)])
def test_shrinkage_is_unbiased_and_covered(train, judge):
    """The truth is the share of the noise-free gap; the interval is not too wide."""
    rng = np.random.default_rng(39)
    truth, errors, held, widths = known_gap(), [], [], []
    for seed in range(150):
        noise = nominal_problem().covariance_factor @ rng.standard_normal(120)
        nominal = replace(nominal_problem(), residual=truth + noise)
        effect = nominal.freed(catalogue()[1].columns, catalogue()[1].prior_sd)
        found = Comparison(nominal, effect, seed, draws=200).shrinkage(train, judge)
        rows = slice(None) if judge is None else judge
        squares = []
        for problem in (nominal, effect):
            step = LinearFit(problem, train, judge).step * problem.nominal_sd
            squares.append(((truth + problem.nominal @ step)[rows] ** 2).mean())
        true = 1 - squares[1] / squares[0]
        errors.append(found.share - true)
        held.append(found.low <= true <= found.high)
        widths.append(found.high - found.low)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.05)
    assert np.mean(held) > 0.9 - 3 * np.sqrt(0.09 / len(held))
    assert np.mean(widths) < 4.5 * np.std(errors)


def test_held_out_shrinkage_is_unbiased_and_covered():
    """The truth is the noise-free gap that the two held-out fits really leave."""
    rng = np.random.default_rng(41)
    truth, errors, held = known_gap(), [], []
    for seed in range(150):
        noise = nominal_problem().covariance_factor @ rng.standard_normal(120)
        nominal = replace(nominal_problem(), residual=truth + noise)
        effect = nominal.freed(catalogue()[1].columns, catalogue()[1].prior_sd)
        found = Comparison(nominal, effect, seed, draws=200).unseen(STATE)[0]
        squares = []
        for problem in (nominal, effect):
            left = [
                truth + problem.nominal @ (LinearFit(problem, ~rows).step * problem.nominal_sd)
                for rows in (LOW, HIGH)
            ]
            squares.append(np.where(LOW, *left) @ np.where(LOW, *left))
        true = 1 - squares[1] / squares[0]
        errors.append(found.share - true)
        held.append(found.low <= true <= found.high)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.05)
    assert np.mean(held) > 0.9 - 3 * np.sqrt(0.09 / len(held))


@pytest.mark.parametrize(("stated", "least"), [(1.0, 0.65), (1.3, 0.8)])
def test_a_small_gap_is_found_although_the_given_noise_is_too_large(stated, least):
    """The only effect is 0.15 mm; noise of 0.3 mm is given as up to 30 % too large."""
    rng = np.random.default_rng(43)
    truth = -0.15 * catalogue()[1].columns[:, 0]
    true = nominal_problem().covariance_factor
    shares, gaps_mm, expected = [], [], []
    for seed in range(100):
        problem = replace(nominal_problem(), covariance_factor=stated * true)
        nominal = replace(problem, residual=truth + true @ rng.standard_normal(120))
        effect = nominal.freed(catalogue()[1].columns, catalogue()[1].prior_sd)
        found = Comparison(nominal, effect, seed, floor_mm=0.03, draws=20).shrinkage()
        shares.append(found.share)
        gaps_mm.append(found.before.gap_mm)
        clean = LinearFit(replace(nominal, residual=truth)).residual
        expected.append(np.sqrt((clean**2).mean()))
    assert np.mean(gaps_mm) == pytest.approx(np.mean(expected), abs=0.03)
    assert np.mean(shares) > least


def test_held_out_shrinkage_pools_single_states():
    nominal, effect = both(np.random.default_rng(42))
    whole = Comparison(nominal, effect, 1, floor_mm=0.1).unseen(STATE)[0]
    compared = Comparison(nominal, effect, 1)
    parts = [compared.shrinkage(~rows, rows) for rows in (LOW, HIGH)]
    assert compared.unseen(STATE)[1] == parts
    less = np.mean([p.before.excess_mm2 - p.after.excess_mm2 for p in parts])
    assert whole.before.excess_mm2 - whole.after.excess_mm2 == pytest.approx(less, rel=1e-10)
    assert whole.share == pytest.approx(less / whole.before.gap_mm**2, rel=1e-10)


def test_a_state_whose_others_do_not_choose_the_effect_keeps_its_gap():
    nominal, effect = both(np.random.default_rng(47))
    compared = Comparison(nominal, effect, 1)
    always, (low, high) = compared.unseen(STATE)
    assert compared.unseen(STATE, [True, True]) == (always, [low, high])
    never, parts = compared.unseen(STATE, [False, False])
    assert (never.share, never.low, never.high) == (0.0, 0.0, 0.0)
    assert [part.share for part in parts] == [0.0, 0.0]
    half, (same, none) = compared.unseen(STATE, [True, False])
    assert same == low
    assert none.after.excess_mm2 == none.before.excess_mm2 == high.before.excess_mm2
    saved = low.before.excess_mm2 - low.after.excess_mm2
    assert half.before.excess_mm2 - half.after.excess_mm2 == pytest.approx(saved / 2, rel=1e-10)


def test_unconstrained_states_are_not_assessed():
    """An effect is visible in only one state, and a hundred times larger there."""
    noise = nominal_problem().covariance_factor @ np.random.default_rng(46).standard_normal(120)
    nominal = replace(nominal_problem(), residual=known_gap() + noise)
    column = 100.0 * catalogue()[1].columns * HIGH[:, None]
    effect = nominal.freed(column, np.ones(1))
    fitted = replace(effect, nominal_offset=np.append(nominal.nominal_offset, 2.0))
    compared = Comparison(nominal, fitted, 1, draws=20)
    whole, (low, high) = compared.unseen(STATE)
    assert compared.shrinkage(LOW, HIGH).after.gap_mm > 50.0
    assert high is None
    assert low == whole == compared.shrinkage(HIGH, LOW)
    own = np.hstack([column, 100.0 * catalogue()[1].columns * LOW[:, None]])
    each = replace(
        nominal.freed(own, np.ones(2)), nominal_offset=np.append(nominal.nominal_offset, [2.0, 2.0])
    )
    assert Comparison(nominal, each, 1, draws=20).unseen(STATE) == (None, [None, None])


def test_an_uncertain_floor_widens_the_interval_of_the_share(monkeypatch):
    nominal, effect = both(np.random.default_rng(44))
    loose = Comparison(nominal, effect, 7, floor_mm=0.15).shrinkage()
    exact = replace(SETTINGS, gap=replace(SETTINGS.gap, floor_range=(1.0, 1.0)))
    monkeypatch.setattr(shrinkages, "SETTINGS", exact)
    firm = Comparison(nominal, effect, 7, floor_mm=0.15).shrinkage()
    assert loose.share == firm.share
    assert loose.low < firm.low
    assert loose.high - loose.low > 1.2 * (firm.high - firm.low)


def test_equal_seeds_give_equal_shrinkages():
    nominal, effect = both(np.random.default_rng(40))
    assert Comparison(nominal, effect, 7).shrinkage() == Comparison(nominal, effect, 7).shrinkage()
    assert (
        Comparison(nominal, effect, 7).shrinkage().low
        != Comparison(nominal, effect, 8).shrinkage().low
    )


def test_shrinkage_is_nan_without_a_gap():
    nominal = nominal_problem()
    effect = nominal.freed(catalogue()[1].columns, catalogue()[1].prior_sd)
    found = Comparison(nominal, effect, 1).shrinkage()
    assert found.before.gap_mm == 0.0
    assert np.isnan([found.share, found.low, found.high]).all()


def scans_that_are_turned(rng):
    """Return fits with free scan poses, without and with an effect that resembles a rotation."""
    points, normals, states = layout(60)
    rigid = rigid_columns(points, normals, (0.0, 0.0, 0.0)) * np.repeat([0.3, 0.3], 3)
    poses = np.hstack([rigid * (states == s)[:, None] for s in (0, 1)])
    turn = rigid[:, 5] * LIKE_A_TURN * (0.3 + 0.7 * (states == 1))
    effect = turn + 0.6 * catalogue()[1].columns[:, 0]
    plain = nominal_problem()
    drawn = plain.covariance_factor @ rng.standard_normal(plain.size)
    truth = -0.5 * effect
    plain = replace(plain, residual=truth + poses @ rng.standard_normal(12) + drawn)
    q = np.ones(12)
    nominal = plain.freed(poses, q)
    return truth, nominal, plain.freed(effect[:, None], np.ones(1)).freed(poses, q)


LIKE_A_TURN = 16.0


def test_scan_poses_come_from_the_best_fit():
    """The model without the effect would rotate the scans, and its gap would be too small."""
    rng = np.random.default_rng(45)
    found, by_itself, true, kept_out = [], [], [], []
    for seed in range(60):
        truth, nominal, effect = scans_that_are_turned(rng)
        own = LinearFit(nominal)
        step = (own.step * nominal.nominal_sd)[:3]
        true.append(((truth + nominal.nominal[:, :3] @ step) ** 2).mean())
        by_itself.append(own.excess_mm2)
        compared = Comparison(nominal, effect, seed, draws=20, registered=12).shrinkage()
        found.append(compared.before.excess_mm2)
        unseen = Comparison(nominal, effect, seed, draws=20, registered=12).unseen(STATE)[0]
        kept_out.append(unseen.share)
    assert np.mean(by_itself) < 0.7 * np.mean(true)
    assert np.mean(found) == pytest.approx(np.mean(true), rel=0.1)
    assert np.median(kept_out) > 0.8


def test_rejects_invalid_input():
    problem = nominal_problem()
    with pytest.raises(InputError, match="train must mark some of 120"):
        LinearFit(problem, np.zeros(120, dtype=bool))
    with pytest.raises(InputError, match="some residuals"):
        gap(LinearFit(problem), np.zeros(120, dtype=bool))
    with pytest.raises(InputError, match="120 and 40 residuals"):
        Comparison(problem, nominal_problem(20), 1)
    with pytest.raises(InputError, match="two or more states; found one"):
        Comparison(problem, problem, 1).unseen(np.zeros(120, dtype=np.int64))
