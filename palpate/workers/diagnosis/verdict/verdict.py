"""The verdict reported to the user: no gap, an effect, a choice of effects, or none of these.

The verdict follows from the probabilities. A hypothesis counts towards its most probable effect; a
hypothesis without effects counts towards "no gap", or towards "none of these" if it has a smooth
field. If a field is needed in addition to effects, an unlisted cause acts, and the effects may only
resemble it; the probability that they do grows with the field's share of the evidence and counts as
"none of these".

1. No gap, if that is the most probable cause. An effect hidden by the nominal parameters (see
   `effect_screening.hides`) has at least its prior probability relative to no
   gap, and counts towards it: these scans cannot show it, and it is neither named nor ruled out.
   Together with a visible effect, it counts towards that effect.
2. None of these, if that is the most probable cause.
3. Otherwise the effect, or, if more than one cause is needed to reach 90 % of the probability, the
   set of causes that cannot be distinguished.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.verdict.hypotheses import (
    Case,
    Hypothesis,
    PriorOdds,
    alarm,
    probabilities,
)

Kind = Literal["no-gap", "effect", "cannot-be-told-apart", "none-of-these"]

NO_GAP, NONE_OF_THESE = "no-gap", "none-of-these"
TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Verdict:
    """The diagnosis of one case.

    Parameters
    ----------
    kind : {"no-gap", "effect", "cannot-be-told-apart", "none-of-these"}
    primary : tuple of str
        The named effects of the most probable hypothesis with effects: the most probable one
        first, others only if each has a probability of at least 90 %. Empty unless `kind` is
        "effect" or "cannot-be-told-apart".
    probabilities : dict of str to float
        Probability that each effect acts, alone or with others; they need not sum to 1.
    no_gap, none_of_these : float
        Probability that there is no gap visible in these scans, and of an unlisted cause.
    set90 : tuple of str
        The smallest set of causes with 90 % of the probability, the most probable first. Effects
        acting together count as the most probable of them; "no-gap" and "none-of-these" may be
        included.
    families : dict of str to float
        Probability that a member of the family acts.
    family : str or None
        The common family of the effects in `set90`; None if they differ or there are none.
    explained_share : float or None
        The best effect's share of the evidence gained by that effect and an added field; None
        without an effect.
    alarm : float
        Log Bayes factor of the best alternative against no gap.
    threshold : float
        Value of `alarm` at which the best other cause would be as probable as no gap.
    hidden : tuple of str
        Effects that the data cannot show.
    hypotheses : dict of Case to float
        Probability of each hypothesis, without and with a smooth field; sums to 1.
    """

    kind: Kind
    primary: tuple[str, ...]
    probabilities: dict[str, float]
    no_gap: float
    none_of_these: float
    set90: tuple[str, ...]
    families: dict[str, float]
    family: str | None
    explained_share: float | None
    alarm: float
    threshold: float
    hidden: tuple[str, ...]
    hypotheses: dict[Case, float]


def verdict(
    hypotheses: Sequence[Hypothesis],
    families: Mapping[str, str],
    hiding: Collection[str] = (),
    odds: PriorOdds | None = None,
) -> Verdict:
    """Weigh the hypotheses.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        Hypotheses, including the one without effects.
    families : mapping of str to str
        The family of every listed effect, whether tried or not.
    hiding : collection of str
        Effects that the nominal parameters hide.
    odds : PriorOdds, optional

    Raises
    ------
    InputError
        If the hypothesis without effects is missing, a hypothesis is repeated, or an effect has
        no family.
    """
    _check(hypotheses, families)
    hidden = tuple(name for name in families if name in hiding)
    visible = _with_hidden(hypotheses, hidden)
    odds = odds or PriorOdds()
    cases = probabilities(visible, len(families), odds)
    alone = {h.effects: h.acting for h in visible}
    beside = {
        h.effects: h.acting_beside * odds.trust(1.0 - _explained(visible, h.effects))
        for h in visible
    }
    acts = {
        (who, field): p * (beside if field else alone)[who]
        for (who, field), p in cases.items()
        if who
    }
    acting = {name: sum(p for (who, _), p in acts.items() if name in who) for name in families}
    causes = _causes(cases, acts, acting, hidden)
    credible = _credible(causes)
    best = _best_named(cases, hidden)
    kind = _kind(credible)
    named = kind in ("effect", "cannot-be-told-apart")
    suspects = {families[name] for name in credible if name in families}
    loudness = alarm(visible)
    return Verdict(
        kind=kind,
        primary=_primary(best, credible[0], acting) if named else (),
        probabilities=acting,
        no_gap=causes[NO_GAP],
        none_of_these=causes[NONE_OF_THESE],
        set90=credible,
        families={
            family: sum(p for (who, _), p in acts.items() if family in map(families.get, who))
            for family in dict.fromkeys(families.values())
        },
        family=suspects.pop() if len(suspects) == 1 else None,
        explained_share=_explained(visible, best) if best else None,
        alarm=loudness,
        threshold=loudness - _log_odds_of_a_gap(causes),
        hidden=hidden,
        hypotheses=cases,
    )


def _check(hypotheses: Sequence[Hypothesis], families: Mapping[str, str]) -> None:
    weighed = [frozenset(h.effects) for h in hypotheses]
    unknown = {name for who in weighed for name in who} - set(families)
    if unknown or len(set(weighed)) < len(weighed) or frozenset() not in weighed:
        raise InputError(
            "Pass each hypothesis once, including the one without effects, and give each effect a "
            f"family; found {len(weighed) - len(set(weighed))} repeated, "
            f"{weighed.count(frozenset())} without effects and no family for {sorted(unknown)}."
        )


def _with_hidden(hypotheses: Sequence[Hypothesis], hidden: Sequence[str]) -> list[Hypothesis]:
    """Return the hypotheses, with hidden effects given at least the evidence of no effects.

    The constants absorb a hidden effect, so a fit with it is as good as one without. The small
    unabsorbed part may support it, but not strongly enough to name it. Combined with other effects,
    it keeps the evidence of its fit.
    """
    nothing = next(h for h in hypotheses if not h.effects)
    kept = [h for h in hypotheses if len(h.effects) != 1 or h.effects[0] not in hidden]
    own = {h.effects[0]: h.log_evidence for h in hypotheses if len(h.effects) == 1}
    least = nothing.log_evidence
    return kept + [Hypothesis((name,), max(own.get(name, least), least)) for name in hidden]


def _causes(
    cases: Mapping[Case, float],
    acts: Mapping[Case, float],
    acting: Mapping[str, float],
    hidden: Sequence[str],
) -> dict[str, float]:
    """Return the probability of each cause, summing to 1."""
    causes = {NO_GAP: 0.0, NONE_OF_THESE: 0.0}
    for (effects, field), p in cases.items():
        shown = [name for name in effects if name not in hidden]
        empty = NONE_OF_THESE if field else NO_GAP
        cause = max(shown, key=lambda name: acting[name]) if shown else empty
        likely = acts[effects, field] if shown else p
        causes[cause] = causes.get(cause, 0.0) + likely
        causes[NONE_OF_THESE] += p - likely
    return causes


def _log_odds_of_a_gap(causes: Mapping[str, float]) -> float:
    """Return the log odds of the best other cause against no gap."""
    other = max(p for cause, p in causes.items() if cause != NO_GAP)
    return float(np.log(max(other, TINY)) - np.log(max(causes[NO_GAP], TINY)))


def _credible(causes: Mapping[str, float]) -> tuple[str, ...]:
    chosen: list[str] = []
    held = 0.0
    for cause, p in sorted(causes.items(), key=lambda item: -item[1]):
        chosen.append(cause)
        held += p
        if held >= SETTINGS.verdict.credible:
            break
    return tuple(chosen)


def _best_named(cases: Mapping[Case, float], hidden: Sequence[str]) -> tuple[str, ...]:
    """Return the effects of the most probable hypothesis with effects; empty if there is none."""
    named = {case: p for case, p in cases.items() if case[0] and not set(case[0]) & set(hidden)}
    return max(named, key=lambda case: named[case])[0] if named else ()


def _primary(effects: tuple[str, ...], cause: str, acting: Mapping[str, float]) -> tuple[str, ...]:
    """Return the most probable effect, and others above the credible level."""
    if cause not in effects:
        return (cause,)
    others = sorted((n for n in effects if n != cause), key=lambda name: -acting[name])
    return (cause, *(name for name in others if acting[name] >= SETTINGS.verdict.credible))


def _explained(hypotheses: Sequence[Hypothesis], effects: tuple[str, ...]) -> float:
    """Return ``le / (le + max(gain, 0))``, with le the log evidence of the effects against none."""
    nothing = next(h for h in hypotheses if not h.effects)
    found = next(h for h in hypotheses if h.effects == effects)
    own = max(0.0, found.log_evidence - nothing.log_evidence)
    return own / (own + max(0.0, found.discrepancy_gain or 0.0)) if own > 0 else 0.0


def _kind(credible: Sequence[str]) -> Kind:
    first = credible[0]
    if first == NO_GAP:
        return "no-gap"
    if first == NONE_OF_THESE:
        return "none-of-these"
    return "effect" if len(credible) == 1 else "cannot-be-told-apart"
