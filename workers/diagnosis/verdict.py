"""What is said to the user: no gap, an effect, a choice of effects, or none of these.

1. No gap if the best alternative raises the log evidence by less than a threshold, which
   `workers.diagnosis.alarm_threshold` calibrates, or if no gap is more probable than not.
2. None of these if a smooth field alone is more probable than all effects together, or
   if the best effect explains less than 70 % of what it and a field explain.
3. Else the effect; or the effects that cannot be told apart, if more than one is needed to
   hold 90 % of the probability.
4. An effect that hides in the nominal parameters is neither accused nor acquitted; see
   `workers.diagnosis.detectability.hides`.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from storage.errors import InputError
from workers.diagnosis.hypotheses import (
    Case,
    Hypothesis,
    PriorOdds,
    alarm,
    probabilities,
    tempered,
)
from workers.diagnosis.settings import SETTINGS

Kind = Literal["no-gap", "effect", "cannot-be-told-apart", "none-of-these"]

NO_GAP, NONE_OF_THESE = "no-gap", "none-of-these"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The diagnosis of one case.

    Parameters
    ----------
    kind : {"no-gap", "effect", "cannot-be-told-apart", "none-of-these"}
    primary : tuple of str
        The effects accused: of the most probable hypothesis with effects, the more probable
        one first, a second one only if it is as probable as the 90 % set: the form of one
        effect is never quite that of the catalogue, and a second one mends it. Empty unless
        `kind` is "effect" or "cannot-be-told-apart".
    probabilities : dict of str to float
        Of each effect acting, alone or with another; they need not sum to 1.
    no_gap, none_of_these : float
        Probability of no gap, and of a smooth field without any effect.
    set90 : tuple of str
        The fewest causes that hold 90 % of the probability, the most probable first. A pair
        counts for its more probable member; "no-gap" and "none-of-these" may be among them.
    families : dict of str to float
        Probability that a member of the family acts.
    family : str or None
        The family that all effects of `set90` belong to; None if they differ or are none.
    explained_share : float or None
        Of the evidence that the best effect and a field on top of it gain, the part of the
        effect; None without one.
    alarm : float
        Log evidence of the best alternative against no gap.
    threshold : float
    hidden : tuple of str
        Effects on which the data cannot speak.
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


def verdict(
    hypotheses: Sequence[Hypothesis],
    families: Mapping[str, str],
    threshold: float,
    hiding: Collection[str] = (),
    odds: PriorOdds | None = None,
    form: float = SETTINGS.verdict.form_uncertainty,
) -> Verdict:
    """Weigh the hypotheses.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        The one without effects and some with.
    families : mapping of str to str
        The family of every effect that was listed, tried or not.
    threshold : float
        Log evidence below which there is no alarm.
    hiding : collection of str
        Effects that the nominal parameters hide.
    odds : PriorOdds, optional
    form : float
        See `workers.diagnosis.hypotheses.tempered`.

    Raises
    ------
    InputError
        If the hypothesis without effects is missing, one comes twice, or an effect has no
        family.
    """
    _check(hypotheses, families)
    hidden = tuple(name for name in families if name in hiding)
    open_ones = [h for h in hypotheses if not set(h.effects) & set(hidden)]
    effects = [name for name in families if name not in hidden]
    cases = probabilities(tempered(open_ones, form), len(effects), odds)
    acting = {name: sum(p for (who, _), p in cases.items() if name in who) for name in effects}
    causes = _causes(cases, acting)
    credible = _credible(causes)
    best = _best_named(cases)
    share = _explained(open_ones, best)
    loudness = alarm(open_ones)
    kind = _kind(causes, credible, share, loudness, threshold)
    accused = kind in ("effect", "cannot-be-told-apart")
    suspects = {families[name] for name in credible if name in families}
    return Verdict(
        kind=kind,
        primary=_primary(best, acting) if accused else (),
        probabilities=acting,
        no_gap=causes[NO_GAP],
        none_of_these=causes[NONE_OF_THESE],
        set90=credible,
        families={
            family: sum(p for (who, _), p in cases.items() if family in map(families.get, who))
            for family in dict.fromkeys(families[name] for name in effects)
        },
        family=suspects.pop() if len(suspects) == 1 else None,
        explained_share=share,
        alarm=loudness,
        threshold=threshold,
        hidden=hidden,
    )


def _check(hypotheses: Sequence[Hypothesis], families: Mapping[str, str]) -> None:
    weighed = [frozenset(h.effects) for h in hypotheses]
    unknown = {name for who in weighed for name in who} - set(families)
    if unknown or len(set(weighed)) < len(weighed) or frozenset() not in weighed:
        raise InputError(
            "Weigh each hypothesis once, the one without effects among them, and give each "
            f"effect a family; found {len(weighed) - len(set(weighed))} repeated, "
            f"{weighed.count(frozenset())} without effects and no family of {sorted(unknown)}."
        )


def _causes(cases: Mapping[Case, float], acting: Mapping[str, float]) -> dict[str, float]:
    """Return probability of each cause; a pair counts for its more probable member. Sums to 1."""
    causes = {NO_GAP: 0.0, NONE_OF_THESE: 0.0}
    for (effects, field), p in cases.items():
        empty = NONE_OF_THESE if field else NO_GAP
        cause = max(effects, key=lambda name: acting[name]) if effects else empty
        causes[cause] = causes.get(cause, 0.0) + p
    return causes


def _credible(causes: Mapping[str, float]) -> tuple[str, ...]:
    chosen: list[str] = []
    held = 0.0
    for cause, p in sorted(causes.items(), key=lambda item: -item[1]):
        chosen.append(cause)
        held += p
        if held >= SETTINGS.verdict.credible:
            break
    return tuple(chosen)


def _best_named(cases: Mapping[Case, float]) -> tuple[str, ...]:
    """Return effects of the most probable hypothesis that has some; empty if none has."""
    named = {case: p for case, p in cases.items() if case[0]}
    return max(named, key=lambda case: named[case])[0] if named else ()


def _primary(effects: tuple[str, ...], acting: Mapping[str, float]) -> tuple[str, ...]:
    """Return the more probable effect, and the other one if it is hardly to be doubted."""
    first, *second = sorted(effects, key=lambda name: -acting[name])
    return (first, *(name for name in second if acting[name] >= SETTINGS.verdict.credible))


def _explained(hypotheses: Sequence[Hypothesis], effects: tuple[str, ...]) -> float | None:
    """le / (le + max(gain, 0)), with le the log evidence of the effects against none."""
    if not effects:
        return None
    nothing = next(h for h in hypotheses if not h.effects)
    found = next(h for h in hypotheses if h.effects == effects)
    own = max(0.0, found.log_evidence - nothing.log_evidence)
    return own / (own + max(0.0, found.discrepancy_gain or 0.0)) if own > 0 else 0.0


def _kind(
    causes: Mapping[str, float],
    credible: Sequence[str],
    share: float | None,
    loudness: float,
    threshold: float,
) -> Kind:
    no_gap, field = causes[NO_GAP], causes[NONE_OF_THESE]
    if loudness < threshold or no_gap > SETTINGS.verdict.no_gap:
        return "no-gap"
    if share is None or share < SETTINGS.verdict.explained_share or field > 1.0 - no_gap - field:
        return "none-of-these"
    named = [cause for cause in credible if cause not in (NO_GAP, NONE_OF_THESE)]
    return "cannot-be-told-apart" if len(named) > 1 else "effect"
