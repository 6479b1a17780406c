"""The rules on hand-made evidence, and the whole chain on cases with a known cause."""

from dataclasses import astuple

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS, OddsSettings
from palpate.workers.diagnosis.fits.effect_screening import screen
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from palpate.workers.diagnosis.verdict.hypotheses import Hypothesis, PriorOdds, probabilities
from palpate.workers.diagnosis.verdict.verdict import verdict
from tests.workers.diagnosis.linear_world import (
    catalogue,
    effect,
    families,
    field_draw,
    hypotheses_of,
    hypothesis_of,
    joint_evidence,
    known_noise_model,
    mode,
    nominal_problem,
    observed,
    signal_of,
)

FAMILIES = {"a": "boundary", "b": "boundary", "c": "loading", "d": "observation"}
NOTHING = Hypothesis((), -100.0, 0.0)


def weigh(*hypotheses, **options):
    return verdict([NOTHING, *hypotheses], FAMILIES, **options)


def test_probabilities_match_hand_calculation():
    """There are four listed effects; only one was tried, without a field.

    ::

        none              .30     x e^0
        none and a field  .15     x e^1
        a                 .38 / 4 x e^2
    """
    tried = [Hypothesis((), -3.0, 1.0), Hypothesis(("a",), -1.0)]
    weights = np.array([0.30, 0.15 * np.e, 0.38 / 4 * np.e**2])
    found = probabilities(tried, 4)
    assert list(found) == [((), False), ((), True), (("a",), False)]
    assert list(found.values()) == pytest.approx(weights / weights.sum())


def test_pairs_share_their_prior_odds():
    tried = [Hypothesis((), 0.0), Hypothesis(("a", "b"), 0.0, 0.0)]
    found = probabilities(tried, 4, PriorOdds(OddsSettings(0.5, 0.1, 0.1, 0.1, 0.12, 0.06)))
    assert found[("a", "b"), False] / found[(), False] == pytest.approx(0.02 / 0.5)
    assert found[("a", "b"), True] / found[(), False] == pytest.approx(0.01 / 0.5)


def test_triples_share_their_prior_odds():
    tried = [Hypothesis((), 0.0), Hypothesis(("a", "b", "c"), 0.0, 0.0)]
    odds = OddsSettings(triple=0.04, triple_and_field=0.02)
    found = probabilities(tried, 4, PriorOdds(odds))
    assert found[("a", "b", "c"), False] / found[(), False] == pytest.approx(0.01 / odds.nothing)
    assert found[("a", "b", "c"), True] / found[(), False] == pytest.approx(0.005 / odds.nothing)


def test_verdict_is_the_most_probable_cause():
    """The verdict changes at the evidence at which an effect is as probable as no gap."""
    even = np.log(SETTINGS.prior_odds.nothing / (SETTINGS.prior_odds.single / 4))
    quiet = weigh(Hypothesis(("a",), -100.0 + even - 0.5))
    assert quiet.kind == "no-gap"
    assert quiet.primary == ()
    assert quiet.no_gap > quiet.probabilities["a"]
    assert quiet.alarm < quiet.threshold
    loud = weigh(Hypothesis(("a",), -100.0 + even + 0.5))
    assert loud.kind == "cannot-be-told-apart"
    assert loud.set90[0] == "a"
    assert loud.primary == ("a",)
    assert loud.alarm == pytest.approx(even + 0.5)
    assert loud.threshold < loud.alarm


def test_a_supported_effect_is_named():
    found = weigh(Hypothesis(("a",), -80.0, -1.0), Hypothesis(("c",), -90.0, 1.0))
    assert found.kind == "effect"
    assert found.primary == found.set90 == ("a",)
    assert found.family == "boundary"
    assert found.explained_share == 1.0
    assert found.probabilities["a"] > 0.95


def test_two_equally_probable_effects_cannot_be_told_apart():
    found = weigh(Hypothesis(("a",), -80.0), Hypothesis(("c",), -80.3))
    assert found.kind == "cannot-be-told-apart"
    assert found.set90 == ("a", "c")
    assert found.family is None
    assert found.probabilities["a"] == pytest.approx(1 / (1 + np.exp(-0.3)), abs=1e-3)


def test_indistinguishable_effects_of_a_family_share_it():
    found = weigh(Hypothesis(("a",), -80.0), Hypothesis(("b",), -80.3))
    assert found.kind == "cannot-be-told-apart"
    assert found.family == "boundary"
    assert found.families["boundary"] == pytest.approx(1.0)


def test_a_field_alone_is_none_of_these():
    hypotheses = [Hypothesis((), -100.0, 30.0), Hypothesis(("a",), -90.0, 19.0)]
    found = verdict(hypotheses, FAMILIES)
    assert found.kind == "none-of-these"
    assert found.none_of_these > 0.5
    assert found.primary == ()


def test_an_imitated_effect_is_none_of_these():
    """The same pattern has a form error too large for a real effect."""
    likeness = Hypothesis(("a",), 0.0, acting=0.1)
    found = weigh(likeness)
    assert found.probabilities["a"] == pytest.approx(0.1, abs=1e-6)
    assert found.none_of_these == pytest.approx(0.9, abs=1e-6)
    assert found.kind == "none-of-these"


def test_an_effect_with_an_unlisted_cause_is_uncertain():
    """The larger the field's share of the evidence, the more probable an imitation is."""
    shares = [0.01, 0.2, 0.8]
    tried = [Hypothesis(("a",), 500.0 * (1 - one), 500.0 * one) for one in shares]
    found = [verdict([Hypothesis((), 0.0, 100.0), one], FAMILIES) for one in tried]
    assert [one.set90 for one in found] == [("a",), ("a", "none-of-these"), ("none-of-these",)]
    # An exponential distribution with mean 0.1 against a uniform one from 0 to 1, at even odds.
    assert found[1].probabilities["a"] == pytest.approx(0.575, abs=0.001)
    assert found[1].none_of_these == pytest.approx(0.425, abs=0.001)
    assert found[1].explained_share == pytest.approx(0.8)


def test_a_field_that_corrects_the_form_is_no_evidence_against_an_effect():
    """Without a field, its form suggests an imitation; with a field, it need not."""
    mended = Hypothesis(("a",), 490.0, 10.0, acting=0.1, acting_beside=0.95)
    same = Hypothesis(("a",), 490.0, 10.0, acting=0.1, acting_beside=0.1)
    nothing = Hypothesis((), 0.0, 100.0)
    found = [verdict([nothing, one], FAMILIES).probabilities["a"] for one in (mended, same)]
    assert found[0] > 0.8
    assert found[1] < 0.15


def test_names_the_more_probable_effect_of_a_pair_first():
    found = weigh(
        Hypothesis(("a",), -90.0), Hypothesis(("c",), -70.0), Hypothesis(("a", "c"), -50.0)
    )
    assert found.kind == "effect"
    assert found.primary == ("c", "a")
    assert found.probabilities["c"] > found.probabilities["a"] > 0.9


def test_a_doubtful_second_effect_is_not_named():
    found = weigh(Hypothesis(("c",), -70.0), Hypothesis(("a", "c"), -69.0))
    assert found.primary == ("c",)
    assert 0 < found.probabilities["a"] < 0.5


def test_three_effects_are_named():
    pair, three = Hypothesis(("a", "c"), -60.0), Hypothesis(("a", "b", "c"), -40.0)
    found = weigh(Hypothesis(("a",), -80.0), pair, three)
    assert found.kind == "effect"
    assert set(found.primary) == {"a", "b", "c"}


def test_hidden_effects_are_neither_named_nor_ruled_out():
    """A hidden effect keeps its evidence in the sum and counts towards no gap."""
    louder = weigh(Hypothesis(("a",), -80.0), Hypothesis(("d",), -60.0), hiding={"d"})
    assert (louder.kind, louder.primary, louder.hidden) == ("no-gap", (), ("d",))
    softer = weigh(Hypothesis(("a",), -60.0), Hypothesis(("d",), -80.0), hiding={"d"})
    assert (softer.kind, softer.primary) == ("effect", ("a",))
    # Constants that absorb the effect fit as well without it, however poor a fit with it is.
    quiet = weigh(Hypothesis(("d",), -140.0), hiding={"d"})
    assert quiet.kind == "no-gap"
    odds = SETTINGS.prior_odds
    assert quiet.probabilities["d"] / quiet.no_gap == pytest.approx(
        (odds.single / 4) / (odds.nothing + odds.single / 4)
    )


def test_a_visible_effect_is_named_with_a_hidden_one():
    """The hidden effect explains more than the visible one, and both together explain the most."""
    alone = Hypothesis(("a",), -94.0), Hypothesis(("d",), -89.0)
    assert weigh(*alone, hiding={"d"}).kind == "no-gap"
    found = weigh(*alone, Hypothesis(("a", "d"), -80.0), hiding={"d"})
    assert (found.kind, found.primary, found.hidden) == ("effect", ("a",), ("d",))
    assert min(found.probabilities["a"], found.probabilities["d"]) > 0.99


def test_rejects_invalid_input():
    with pytest.raises(InputError, match=r"no family for \['e'\]"):
        weigh(Hypothesis(("e",), -80.0))
    with pytest.raises(InputError, match="1 repeated"):
        weigh(Hypothesis(("a", "b"), -80.0), Hypothesis(("b", "a"), -80.0))
    with pytest.raises(InputError, match="0 without effects"):
        verdict([Hypothesis(("a",), -80.0)], FAMILIES)
    with pytest.raises(InputError, match="3 different effects"):
        Hypothesis(("a", "a"), 0.0)
    with pytest.raises(InputError, match="did not converge"):
        Hypothesis(("a",), float("nan"))


# --- the whole chain in the linear world --------------------------------------------------


def diagnose(problem, sensitivities):
    joint = joint_evidence(problem, sensitivities)
    hiding = {f.name for f in screen(problem, sensitivities) if f.hides}
    return verdict(hypotheses_of(joint), families(sensitivities), hiding)


def test_joint_evidence_equals_each_fit():
    rng = np.random.default_rng(51)
    problem = observed(nominal_problem(), rng, signal_of(catalogue()[3], rng))
    joint, noise = joint_evidence(problem, catalogue()), known_noise_model()
    tilt, friction = catalogue()[1:3]
    pair = problem.freed(np.hstack([tilt.columns, friction.columns]), np.array([0.5, 0.5]))
    sided = np.array([False] * 4 + [True])
    names = ("tilt", "friction")
    found = joint.log_evidence(names) - joint.log_evidence(())
    expected = log_evidence(pair, sided) - log_evidence(problem)
    assert found == pytest.approx(expected, abs=1e-8)
    gain = noise.field_gain(hypothesis_of(pair, sided))
    assert joint.hypothesis(names).discrepancy_gain == pytest.approx(gain, abs=1e-8)
    for result in screen(problem, catalogue()):
        gain = joint.log_evidence((result.name,)) - joint.log_evidence(())
        assert gain == pytest.approx(result.log_bayes_factor, abs=1e-8)


@pytest.mark.parametrize("index", range(6))
def test_each_strong_effect_is_named(index):
    sensitivity = catalogue()[index]
    signal = -sensitivity.places[-1] @ (2.0 * sensitivity.prior_sd)
    problem = observed(nominal_problem(), np.random.default_rng(52), signal)
    found = diagnose(problem, catalogue())
    assert found.kind == "effect"
    assert found.primary == (sensitivity.name,)


def test_a_pair_of_acting_effects_is_found():
    tilt, stiffening = catalogue()[1], catalogue()[4]
    signal = -0.6 * tilt.columns[:, 0] - 0.7 * stiffening.columns[:, 0]
    found = diagnose(observed(nominal_problem(), np.random.default_rng(53), signal), catalogue())
    assert found.kind == "effect"
    assert set(found.primary) == {"tilt", "stiffening"}


def test_twin_effects_cannot_be_told_apart():
    """Two effects with almost the same columns."""
    tilt = catalogue()[1]
    other = tilt.columns[:, 0] + 0.03 * mode(60, (1, 1, 0), 2, 1.0)
    sensitivities = (*catalogue(), effect("flex", other, 0.5, family="plate geometry"))
    problem = observed(nominal_problem(), np.random.default_rng(54), -0.6 * tilt.columns[:, 0])
    found = diagnose(problem, sensitivities)
    assert found.kind == "cannot-be-told-apart"
    assert set(found.set90) == {"tilt", "flex"}
    assert found.family == "plate geometry"


def test_a_smooth_field_without_a_listed_cause_is_none_of_these():
    rng = np.random.default_rng(55)
    kinds = []
    while len(kinds) < 12:
        field = field_draw(60, rng)
        if 0.25 < np.std(field) < 0.6:
            kinds.append(diagnose(observed(nominal_problem(), rng, field), catalogue()).kind)
    assert kinds.count("none-of-these") >= 11


def test_a_force_that_scales_like_a_nominal_parameter_is_hidden():
    force = effect("force", nominal_problem().nominal[:, 1] * 0.8, 0.5)
    problem = observed(
        nominal_problem(), np.random.default_rng(56), signal_of(force, np.random.default_rng(1))
    )
    found = diagnose(problem, (*catalogue(), force))
    assert found.hidden == ("force",)
    assert found.kind == "no-gap"


@pytest.fixture(scope="module")
def drawn_cases():
    """Return cases drawn from the prior odds: the effects that act, and the verdict."""
    rng = np.random.default_rng(57)
    sensitivities = catalogue()[:5]
    labels = ["nothing", "field", "single", "single field", "pair", "pair field"]
    odds = PriorOdds(OddsSettings(beside_unlisted=1.0))  # effects are never imitated here
    each = np.array(astuple(odds.kinds)[:6])
    cases = []
    for kind in rng.choice(labels, size=300, p=each / each.sum()):
        count = 2 if "pair" in kind else int("single" in kind)
        acting = rng.choice(5, size=count, replace=False)
        signal = sum((signal_of(sensitivities[i], rng) for i in acting), np.zeros(120))
        if "field" in kind:
            signal = signal + field_draw(60, rng)
        problem = observed(nominal_problem(), rng, signal)
        joint = joint_evidence(problem, sensitivities)
        found = verdict(hypotheses_of(joint), families(sensitivities), odds=odds)
        cases.append((kind, [sensitivities[i].name for i in acting], found))
    return cases


def test_probabilities_are_reliable(drawn_cases):
    """In each bin, the share of acting effects is the mean probability, to 3 binomial errors."""
    claims = np.array([p for _, _, v in drawn_cases for p in v.probabilities.values()])
    acts = np.array([n in who for _, who, v in drawn_cases for n in v.probabilities])
    for low, high in ((0.0, 0.05), (0.05, 0.2), (0.2, 0.6), (0.6, 0.95), (0.95, 1.01)):
        inside = (claims >= low) & (claims < high)
        assert inside.sum() > 12
        error = np.sqrt((claims[inside] * (1 - claims[inside])).sum()) / inside.sum()
        difference = acts[inside].mean() - claims[inside].mean()
        assert abs(difference) < 3 * error + 0.005, (low, difference, error)


def test_the_probability_of_no_gap_is_reliable(drawn_cases):
    claims = np.array([v.no_gap for _, _, v in drawn_cases])
    empty = np.array([kind == "nothing" for kind, _, _ in drawn_cases])
    error = np.sqrt((claims * (1 - claims)).sum())
    assert abs(empty.sum() - claims.sum()) < 3 * error


def test_the_90_per_cent_set_covers_the_acting_effects(drawn_cases):
    """A pair is covered if one of its members is; coverage exceeds 90 % rather than missing it."""
    held = []
    for kind, who, found in drawn_cases:
        truth = set(who) or {"none-of-these" if kind == "field" else "no-gap"}
        held.append(bool(truth & set(found.set90)))
    assert np.mean(held) > 0.9 - 3 * np.sqrt(0.09 / len(held))
    assert np.mean([len(v.set90) for _, _, v in drawn_cases]) < 2.5


def test_a_rarer_effect_needs_more_evidence():
    """The additional evidence needed is minus the logarithm of its prior factor."""
    rare = PriorOdds(of_effect={"a": 0.2})
    told = [Hypothesis((), 0.0), Hypothesis(("a",), 1.0), Hypothesis(("b",), 1.0 + np.log(0.2))]
    found = probabilities(told, 5, rare)
    assert found[("a",), False] == pytest.approx(found[("b",), False])
    both = [Hypothesis((), 0.0), Hypothesis(("a", "b"), 2.0), Hypothesis(("b", "c"), 2.0)]
    found = probabilities(both, 5, rare)
    assert found[("a", "b"), False] == pytest.approx(0.2 * found[("b", "c"), False])


def test_prior_odds_must_be_positive():
    with pytest.raises(InputError, match="odds must be > 0"):
        PriorOdds(of_effect={"a": 0.0})
