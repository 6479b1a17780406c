"""Plans in words, for the person who takes the scans, and the ranking of further measurements."""

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

from palpate.service.diagnosis.diagnosis_words import spoken, together
from palpate.service.number_formatting import NONE, listed, number
from palpate.workers.diagnosis.outcome.diagnosis_summary import NextAcquisition, Summary
from palpate.workers.diagnosis.plan_summary import (
    FurtherMeasurement,
    ParameterPlan,
    PlannedEffect,
    PlanSummary,
)
from palpate.workers.organs.organ_plugins import DEFAULT, catalogue_of

PLAN_DIGITS = 2
# Number of measurements to list.
SHOWN_ACQUISITIONS = 4
WHY_NOT_FOUND = {
    "hidden": "absorbed by the constants",
    "weak": "too weak at its plausible size",
    "": "can be found",
}


def plan_headline(plan: PlanSummary) -> str:
    """Return the findings that the planned scans allow, in two sentences."""
    scans = plan.scans
    seen = len(plan.effects) - len(plan.silent)
    ones = "One scan" if len(scans) == 1 else f"{len(scans)} scans"
    return (
        f"{ones} ({listed(scans)}) can find {seen} of {len(plan.effects)} effects at their "
        f"plausible size and distinguish {plan.told_apart} of {plan.pairs} pairs of them. "
        f"{_best_measurement(plan)}"
    ).rstrip()


def silent_effects(plan: PlanSummary) -> str:
    """Return the effects that can be neither confirmed nor ruled out; empty if none."""
    parts = []
    for why, words in (("hidden", "absorbed by the constants"), ("weak", "too weak")):
        names = [e.name for e in plan.effects if e.why_not == why]
        if names:
            parts.append(f"{together(names)} ({words})")
    return f"Neither confirmed nor ruled out: {'; '.join(parts)}." if parts else ""


def confused_effects(plan: PlanSummary) -> str:
    """Return the pairs that are detected but not distinguished; empty if there are none."""
    pairs = [
        f"{' or '.join(map(spoken, p.effects))} ({p.log_evidence:.1f})" for p in plan.confusable
    ]
    if not pairs:
        return ""
    return f"Not distinguished, with the expected log evidence in nats: {'; '.join(pairs)}."


def drift_advice(plan: PlanSummary) -> str:
    """Return the effects with meaningless numbers and a remedy; empty if there are none."""
    if not plan.loose:
        return ""
    effects = catalogue_of(DEFAULT).effects
    holding = [p.door_name for e in effects if e.holds_body for p in e.parameters]
    return (
        f"Nothing holds the body sideways: {together(plan.loose)} would push it away, so their "
        "numbers mean little. Fix it to the chest wall with springs kx and ky in case.yaml, or "
        f"{listed(holding)} under case.constants of a study."
    )


def planned_amounts(
    parameters: Sequence[ParameterPlan], which: Literal["minimum", "plausible"]
) -> str:
    """Return the magnitudes of an effect's parameters as text, with a range for each unit.

    Examples
    --------
    >>> tilts = [ParameterPlan("a", "deg", 1.04, 2.0), ParameterPlan("b", "deg", 0.13, 2.0)]
    >>> planned_amounts(tilts, "minimum")
    '0.13 to 1 deg'
    >>> planned_amounts([ParameterPlan("a", "", None, 2.0)], "minimum")
    '–'
    """
    words = []
    shown = [p.shown for p in parameters]
    for unit in dict.fromkeys(unit for *_, unit in shown):
        own = [(least, size) for least, size, other in shown if other == unit]
        known = [least if which == "minimum" else size for least, size in own]
        values = sorted(value for value in known if value is not None)
        if values:
            ends = dict.fromkeys(number(v, PLAN_DIGITS) for v in (values[0], values[-1]))
            words.append(f"{' to '.join(ends)} {unit}".rstrip())
    return ", ".join(words) or NONE


def nearest_effect(effect: PlannedEffect) -> str:
    """Return the most similar effect and the cosine."""
    if effect.nearest is None:
        return NONE
    return f"{spoken(effect.nearest)} {effect.cosine:.2f}"


def measurement_gain(acquisition: FurtherMeasurement) -> str:
    """Return a phrase on the gain from a further measurement."""
    said = []
    more = acquisition.more_told_apart
    if more > 0:
        said.append(f"{more} more {'pair' if more == 1 else 'pairs'} distinguished")
    if acquisition.reveals:
        said.append(f"reveals {together(acquisition.reveals)}")
    if acquisition.separates:
        pairs = ["{} from {}".format(*map(spoken, pair)) for pair in acquisition.separates]
        said.append(f"separates {listed(pairs)}")
    return "; ".join(said) or "no further pairs distinguished"


def _best_measurement(plan: PlanSummary) -> str:
    if not plan.acquisitions:
        return ""
    first = plan.acquisitions[0]
    if first.more_told_apart <= 0:
        return "None of the further measurements considered would distinguish more pairs."
    return f"The most informative would be {first.name}: {measurement_gain(first)}."


def next_acquisitions(summary: Summary, plan: PlanSummary) -> tuple[NextAcquisition, ...]:
    """Rank the measurements evaluated in a plan, the most decisive first.

    The criteria are the number of pairs of rivals that are distinguished, then the number
    of absorbed effects that are revealed, then the order of the plan.

    Parameters
    ----------
    summary : Summary
    plan : PlanSummary
        Plan for the same scans.
    """
    suspects = {frozenset(p) for p in combinations(summary.rivals, 2)}
    hidden = set(summary.absorbed)
    options = [
        NextAcquisition(
            name=acquisition.name,
            separates=tuple(pair for pair in acquisition.separates if frozenset(pair) in suspects),
            reveals=tuple(name for name in acquisition.reveals if name in hidden),
            minimum_ratio=acquisition.minimum_ratio,
        )
        for acquisition in plan.acquisitions
    ]
    ranked = sorted(options, key=lambda one: (-len(one.separates), -len(one.reveals)))
    return tuple(ranked[:SHOWN_ACQUISITIONS])


def acquisition_worth(option: NextAcquisition) -> str:
    """Return a phrase on what a measurement would decide.

    Examples
    --------
    >>> acquisition_worth(NextAcquisition("a view", (("gravity_change", "fibre_fan"),), (), 0.62))
    'distinguishes gravity change from fibre fan; detection limits become 0.62 times as large'
    """
    pairs = [f"{spoken(a)} from {spoken(b)}" for a, b in option.separates]
    words = [f"distinguishes {listed(pairs)}"] if pairs else []
    if option.reveals:
        words.append(f"reveals {together(option.reveals)}")
    words.append(f"detection limits become {option.minimum_ratio:.2f} times as large")
    return "; ".join(words)
