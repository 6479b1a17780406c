"""A plan in words, for the person who takes the scans."""

from collections.abc import Sequence
from typing import Literal

from palpate.service.diagnosis.words import listed, spoken, together
from palpate.service.formatting import NONE, number
from palpate.workers.diagnosis.schema.plan import (
    FurtherMeasurement,
    ParameterPlan,
    PlannedEffect,
    PlanSummary,
)
from palpate.workers.organs.registry import DEFAULT, catalogue_of

DIGITS = 2
WHY = {
    "hidden": "absorbed by the constants",
    "weak": "too weak at its plausible size",
    "": "can be found",
}


def headline(plan: PlanSummary) -> str:
    """Return the findings that the planned scans allow, in two sentences."""
    scans = plan.scans
    seen = len(plan.effects) - len(plan.silent)
    ones = "One scan" if len(scans) == 1 else f"{len(scans)} scans"
    return (
        f"{ones} ({listed(scans)}) can find {seen} of {len(plan.effects)} effects at their "
        f"plausible size and distinguish {plan.told_apart} of {plan.pairs} pairs of them. "
        f"{_best(plan)}"
    ).rstrip()


def silence(plan: PlanSummary) -> str:
    """Return the effects that can be neither confirmed nor ruled out; empty if none."""
    parts = []
    for why, words in (("hidden", "absorbed by the constants"), ("weak", "too weak")):
        names = [e.name for e in plan.effects if e.why_not == why]
        if names:
            parts.append(f"{together(names)} ({words})")
    return f"Neither confirmed nor ruled out: {'; '.join(parts)}." if parts else ""


def confusions(plan: PlanSummary) -> str:
    """Return the pairs that are detected but not distinguished; empty if there are none."""
    pairs = [
        f"{' or '.join(map(spoken, p.effects))} ({p.log_evidence:.1f})" for p in plan.confusable
    ]
    if not pairs:
        return ""
    return f"Not distinguished, with the expected log evidence: {'; '.join(pairs)}."


def drift(plan: PlanSummary) -> str:
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


def amounts(parameters: Sequence[ParameterPlan], which: Literal["minimum", "plausible"]) -> str:
    """Return the magnitudes of an effect's parameters as text, with a range for each unit.

    Examples
    --------
    >>> tilts = [ParameterPlan("a", "deg", 1.04, 2.0), ParameterPlan("b", "deg", 0.13, 2.0)]
    >>> amounts(tilts, "minimum")
    '0.13 to 1 deg'
    >>> amounts([ParameterPlan("a", "", None, 2.0)], "minimum")
    '–'
    """
    words = []
    shown = [p.shown for p in parameters]
    for unit in dict.fromkeys(unit for *_, unit in shown):
        own = [(least, size) for least, size, other in shown if other == unit]
        known = [least if which == "minimum" else size for least, size in own]
        values = sorted(value for value in known if value is not None)
        if values:
            ends = dict.fromkeys(number(v, DIGITS) for v in (values[0], values[-1]))
            words.append(f"{' to '.join(ends)} {unit}".rstrip())
    return ", ".join(words) or NONE


def nearest(effect: PlannedEffect) -> str:
    """Return the most similar effect and the cosine."""
    if effect.nearest is None:
        return NONE
    return f"{spoken(effect.nearest)} {effect.cosine:.2f}"


def gain(acquisition: FurtherMeasurement) -> str:
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


def _best(plan: PlanSummary) -> str:
    if not plan.acquisitions:
        return ""
    first = plan.acquisitions[0]
    if first.more_told_apart <= 0:
        return "None of the further measurements considered would distinguish more pairs."
    return f"The most informative would be {first.name}: {gain(first)}."
