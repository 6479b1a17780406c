"""What may be the case, how probable it is before data, and after.

An image may show no gap, a gap that no listed effect explains (a smooth field alone), or one to
three effects; with effects, a smooth field may stand for something else beside them. That no real
effect has just the form that is listed is in the evidence of each; see
`workers.diagnosis.screening.form_error`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.special import logsumexp

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.settings.values import SETTINGS, OddsSettings

MOST_EFFECTS = 3

Case = tuple[tuple[str, ...], bool]
"""The effects, and whether there is a smooth field too."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Evidence of some effects acting together.

    Parameters
    ----------
    effects : tuple of str
        None to three.
    log_evidence : float
        In nats; all hypotheses on one scale. An effect that was not fitted again may come
        with the evidence of the linear model.
    discrepancy_gain : float, optional
        By how much a smooth field raises it; None if that was not tried.
    acting, acting_beside : float
        How probably the effects act and do not only resemble a cause that is not listed, without
        and with a smooth field beside them; see `workers.diagnosis.screening.form_error`.

    Raises
    ------
    InputError
        If there are more than three effects, or one twice, or the evidence is not finite.
    """

    effects: tuple[str, ...]
    log_evidence: float
    discrepancy_gain: float | None = None
    acting: float = 1.0
    acting_beside: float = 1.0

    def __post_init__(self) -> None:
        if len(self.effects) > MOST_EFFECTS or len(set(self.effects)) < len(self.effects):
            raise InputError(
                f"A hypothesis has up to {MOST_EFFECTS} different effects, got {self.effects}."
            )
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
    """How probable each kind of hypothesis is before data; split among its members.

    Evenly, but for `of_effect`, by how much each effect is more probable than others.

    Raises
    ------
    InputError
        If one is not positive.
    """

    kinds: OddsSettings = SETTINGS.prior_odds
    of_effect: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not min([*dataclasses.astuple(self.kinds), *self.of_effect.values()]) > 0:
            raise InputError(f"Prior odds must be > 0, found {self}.")

    def trust(self, unlisted: float) -> float:
        """Return how probably effects act and are not a mere likeness of what is not listed.

        Parameters
        ----------
        unlisted : float
            Part of the evidence, 0 to 1, that a smooth field gains beside them.
        """
        mean = self.kinds.unlisted_part
        acting = np.exp(-unlisted / mean) / (mean * -np.expm1(-1.0 / mean))
        likeness = (1.0 - self.kinds.beside_unlisted) / self.kinds.beside_unlisted
        return float(acting / (acting + likeness))

    def log_prior(self, case: Case, catalogue: int) -> float:
        """Return that of one hypothesis, up to a constant, of a catalogue of so many effects."""
        effects, field = case
        of = self.kinds
        kinds = (
            (of.nothing, of.field),
            (of.single, of.single_and_field),
            (of.pair, of.pair_and_field),
            (of.triple, of.triple_and_field),
        )
        even = np.log(kinds[len(effects)][field] / comb(catalogue, len(effects)))
        return float(even + sum(np.log(self.of_effect.get(name, 1.0)) for name in effects))


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
    """Return log evidence of the best alternative against no gap.

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
    alternatives = [h.best for h in hypotheses if h.effects]
    return max([*alternatives, nothing[0].best]) - nothing[0].log_evidence
