"""What may be the case, how probable it is before data, and after.

An image may show no gap, a gap that no listed effect explains (a smooth field alone), one
effect, or two; with effects, a smooth field may stand for what their form misses. A single
effect with a field is as probable beforehand as without one, for no real effect has just
the form that is listed: otherwise a second effect would be called in to mend the form of
the first.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from math import comb

import numpy as np
from scipy.special import logsumexp

from storage.errors import InputError
from workers.diagnosis.settings import SETTINGS

Case = tuple[tuple[str, ...], bool]
"""The effects, and whether there is a smooth field too."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Evidence of some effects acting together.

    Parameters
    ----------
    effects : tuple of str
        None, one or two.
    log_evidence : float
        In nats; all hypotheses on one scale. An effect that was not fitted again may come
        with the evidence of the linear model.
    discrepancy_gain : float, optional
        By how much a smooth field raises it; None if that was not tried.

    Raises
    ------
    InputError
        If there are more than two effects, or one twice, or the evidence is not finite.
    """

    effects: tuple[str, ...]
    log_evidence: float
    discrepancy_gain: float | None = None

    def __post_init__(self) -> None:
        if len(self.effects) > 2 or len(set(self.effects)) < len(self.effects):
            raise InputError(f"A hypothesis has up to two different effects, got {self.effects}.")
        if not np.isfinite([self.log_evidence, self.discrepancy_gain or 0.0]).all():
            raise InputError(
                f"The evidence of {self.effects or 'no effect'} must be finite, found "
                f"{self.log_evidence} and {self.discrepancy_gain}. Leave out what did not converge."
            )

    @property
    def best(self) -> float:
        """Log evidence with the field if that helps."""
        return self.log_evidence + max(0.0, self.discrepancy_gain or 0.0)


@dataclass(frozen=True, slots=True)
class PriorOdds:
    """How probable each kind of hypothesis is before data; split evenly among its members.

    Raises
    ------
    InputError
        If one is not positive.
    """

    nothing: float = SETTINGS.prior_odds.nothing
    field: float = SETTINGS.prior_odds.field
    single: float = SETTINGS.prior_odds.single
    single_and_field: float = SETTINGS.prior_odds.single_and_field
    pair: float = SETTINGS.prior_odds.pair
    pair_and_field: float = SETTINGS.prior_odds.pair_and_field

    def __post_init__(self) -> None:
        if not min(astuple(self)) > 0:
            raise InputError(f"Prior odds must be > 0, found {astuple(self)}.")

    def log_prior(self, case: Case, catalogue: int) -> float:
        """Return that of one hypothesis, up to a constant, of a catalogue of so many effects."""
        effects, field = case
        kinds = (
            (self.nothing, self.field),
            (self.single, self.single_and_field),
            (self.pair, self.pair_and_field),
        )
        return float(np.log(kinds[len(effects)][field] / comb(catalogue, len(effects))))


def tempered(
    hypotheses: Sequence[Hypothesis], form: float = SETTINGS.verdict.form_uncertainty
) -> list[Hypothesis]:
    """Return single effects, compared no more sharply than their forms are known.

    The likelihood of a model that is only nearly right is raised to a power below one
    (P. Gruenwald and T. van Ommen, Bayesian Anal. 12 (2017) 1069). Of two effects that explain
    hundreds of nats, one does not win by six. A field on top of an effect counts as far as the
    effect still explains `explained_share` of the settings of both: where a gap is large, the
    field would else bring effects that do nothing close to the best one. Pairs, the smooth field
    and no gap stay.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        The one without effects among them.
    form : float
        Part of the best gain by which evidence is uncertain; 0 where forms are exact, and
        hypotheses stay as they are.
    """
    if not form:
        return list(hypotheses)
    nothing = next(h for h in hypotheses if not h.effects)
    mended = [_mended(h, nothing) if len(h.effects) == 1 else h for h in hypotheses]
    singles = [h.best for h in mended if len(h.effects) == 1]
    if not singles:
        return mended
    top = max(singles)
    blunt = max(1.0, form * (top - nothing.log_evidence))

    def moved(h: Hypothesis) -> Hypothesis:
        lift = (top - h.best) * (1.0 - 1.0 / blunt)
        return replace(h, log_evidence=h.log_evidence + lift)

    return [moved(h) if len(h.effects) == 1 else h for h in mended]


def _mended(h: Hypothesis, nothing: Hypothesis) -> Hypothesis:
    """Return a hypothesis with no more of a field than mends its form."""
    if h.discrepancy_gain is None:
        return h
    own = max(0.0, h.log_evidence - nothing.log_evidence)
    most = own * (1.0 / SETTINGS.verdict.explained_share - 1.0)
    return replace(h, discrepancy_gain=min(h.discrepancy_gain, most))


def probabilities(
    hypotheses: Sequence[Hypothesis], catalogue: int, odds: PriorOdds | None = None
) -> dict[Case, float]:
    """Return posterior probability of each hypothesis, with and without the field.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
    catalogue : int
        How many effects are listed. A hypothesis that is missing keeps its part of the
        prior odds, so choosing candidates by the data earns nothing.
    odds : PriorOdds, optional

    Returns
    -------
    dict of Case to float
        Sums to 1.
    """
    odds = odds or PriorOdds()
    logs: dict[Case, float] = {}
    for hypothesis in hypotheses:
        plain: Case = (hypothesis.effects, False)
        logs[plain] = hypothesis.log_evidence + odds.log_prior(plain, catalogue)
        if hypothesis.discrepancy_gain is not None:
            case: Case = (hypothesis.effects, True)
            evidence = hypothesis.log_evidence + hypothesis.discrepancy_gain
            logs[case] = evidence + odds.log_prior(case, catalogue)
    total = logsumexp(list(logs.values()))
    return {case: float(np.exp(value - total)) for case, value in logs.items()}


def alarm(hypotheses: Sequence[Hypothesis]) -> float:
    """Return log evidence of the best alternative with one effect at most, against no gap.

    Pairs are left out: null replicates need not try them all, and two effects that no single
    one and no field can stand for are not seen.

    Raises
    ------
    InputError
        If the hypothesis without effects is missing.
    """
    nothing = [h for h in hypotheses if not h.effects]
    if len(nothing) != 1:
        raise InputError(
            f"The hypothesis without effects is needed once, found {len(nothing)} times."
        )
    alternatives = [h.best for h in hypotheses if len(h.effects) == 1]
    return max([*alternatives, nothing[0].best]) - nothing[0].log_evidence
