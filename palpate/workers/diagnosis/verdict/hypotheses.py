"""Hypotheses with their evidence in the linear model, and their prior and posterior probabilities.

Scans may show no gap, a gap that no listed effect explains (a smooth field alone), or one to three
effects, with or without a smooth field for other causes. The evidence of each hypothesis allows for
real effects that differ from their listed form; see `workers.diagnosis.fits.model_errors`.

The evidence for all hypotheses comes from one table of inner products. Every hypothesis frees a
subset of the same columns, so its curvature and gradient are parts of the full arrays. Hundreds of
hypotheses, with the smooth field and for many vectors of residuals, therefore cost little more than
one.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb

import numpy as np
from scipy.special import logsumexp

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS, OddsSettings
from palpate.workers.diagnosis.laplace_evidence import Quadratic, log_marginal
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.noise.averaged_evidence import (
    LinearHypothesis,
    NoiseModel,
    with_pose_scales,
)

MOST_EFFECTS = 3

Case = tuple[tuple[str, ...], bool]
"""The effects, and whether a smooth field is added."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Evidence for a set of effects acting together.

    Parameters
    ----------
    effects : tuple of str
        Zero to three effects.
    log_evidence : float
        Log evidence in nats, on a common scale for all hypotheses; from the linear model if the
        effects were not refitted.
    discrepancy_gain : float, optional
        Increase in log evidence due to a smooth field; None if no field was tried.
    acting, acting_beside : float
        Probability that the effects act rather than resemble an unlisted cause, without and with
        a smooth field; see `workers.diagnosis.fits.model_errors`.

    Raises
    ------
    InputError
        If there are more than three effects, an effect is repeated, or the evidence is not finite.
    """

    effects: tuple[str, ...]
    log_evidence: float
    discrepancy_gain: float | None = None
    acting: float = 1.0
    acting_beside: float = 1.0

    def __post_init__(self) -> None:
        if len(self.effects) > MOST_EFFECTS or len(set(self.effects)) < len(self.effects):
            raise InputError(
                f"A hypothesis can have up to {MOST_EFFECTS} different effects, got {self.effects}."
            )
        if not np.isfinite([self.log_evidence, self.discrepancy_gain or 0.0]).all():
            raise InputError(
                f"The evidence of {self.effects or 'no effect'} must be finite, found "
                f"{self.log_evidence} and {self.discrepancy_gain}. Omit hypotheses that did not "
                "converge."
            )

    def coarsened(self, power: float) -> "Hypothesis":
        """Return the hypothesis with its evidence raised to a power."""
        gain = self.discrepancy_gain
        return dataclasses.replace(
            self,
            log_evidence=power * self.log_evidence,
            discrepancy_gain=None if gain is None else power * gain,
        )

    @property
    def best(self) -> float:
        """Log evidence, with the field if that increases it."""
        return self.log_evidence + max(0.0, self.discrepancy_gain or 0.0)


@dataclass(frozen=True, slots=True)
class PriorOdds:
    """Prior odds of each kind of hypothesis, split among the hypotheses of that kind.

    The split is even, except for the factors of single effects in `of_effect`.

    Raises
    ------
    InputError
        If any odds are not positive.
    """

    kinds: OddsSettings = SETTINGS.prior_odds
    of_effect: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not min([*dataclasses.astuple(self.kinds), *self.of_effect.values()]) > 0:
            raise InputError(f"Prior odds must be > 0, found {self}.")

    def trust(self, unlisted: float) -> float:
        """Return the probability that effects act rather than resemble an unlisted cause.

        Parameters
        ----------
        unlisted : float
            Share of the evidence, 0 to 1, that is gained by adding a smooth field.
        """
        mean = self.kinds.unlisted_part
        acting = np.exp(-unlisted / mean) / (mean * -np.expm1(-1.0 / mean))
        likeness = (1.0 - self.kinds.beside_unlisted) / self.kinds.beside_unlisted
        return float(acting / (acting + likeness))

    def log_prior(self, case: Case, catalogue: int) -> float:
        """Return the unnormalised log prior of a hypothesis, given the size of the catalogue."""
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
    """Return the posterior probability of each hypothesis, with and without the field.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
    catalogue : int
        Number of listed effects. A missing hypothesis keeps its share of the prior odds, so
        selecting candidates by means of the data gives no advantage.
    odds : PriorOdds, optional

    Returns
    -------
    dict of Case to float
        Probabilities, which sum to 1.
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
    """Return the log Bayes factor of the best alternative against no gap.

    Raises
    ------
    InputError
        If the hypothesis without effects is missing.
    """
    nothing = [h for h in hypotheses if not h.effects]
    if len(nothing) != 1:
        raise InputError(
            f"The hypothesis without effects must occur exactly once, found {len(nothing)}."
        )
    alternatives = [h.best for h in hypotheses if h.effects]
    return max([*alternatives, nothing[0].best]) - nothing[0].log_evidence


AT_ONCE = 512  # number of places whose curvatures take a few megabytes


class JointEvidence:
    """Log evidences of effects at the nominal fit.

    Parameters
    ----------
    nominal : LinearHypothesis
        Linearisation at the fit of the nominal parameters.
    sensitivities : sequence of EffectSensitivity
        Sensitivities with distinct names.
    noise : NoiseModel
        Noise of the same residuals.

    Raises
    ------
    InputError
        If a name is repeated or the numbers of residuals differ.
    """

    def __init__(
        self,
        nominal: LinearHypothesis,
        sensitivities: Sequence[EffectSensitivity],
        noise: NoiseModel,
    ) -> None:
        names = [f.name for f in sensitivities]
        if len(set(names)) < len(names):
            raise InputError(f"Each effect must be listed once, found {names}.")
        if noise.size != len(nominal.residual):
            raise InputError(
                f"The noise model is for {noise.size} residuals, but the fit has "
                f"{len(nominal.residual)}. Create the noise model from the points of the fit."
            )
        p = nominal.columns.shape[1]
        blocks: list[FloatArray] = [nominal.columns]
        sided: list[BoolArray] = [nominal.one_sided]
        self._columns: dict[str, list[IntArray]] = {}
        for sensitivity in sensitivities:
            self._columns[sensitivity.name] = []
            for place in sensitivity.places:
                start = sum(block.shape[1] for block in blocks)
                stop = start + place.shape[1]
                self._columns[sensitivity.name].append(np.arange(start, stop, dtype=np.int32))
                blocks.append(place * sensitivity.prior_sd)
                sided.append(sensitivity.one_sided)
        self._nominal = np.arange(p, dtype=np.int32)
        self._sided = np.concatenate(sided)
        self._offset = np.zeros(len(self._sided))
        self._offset[:p] = nominal.offset
        self._is_pose = np.zeros(len(self._sided), np.bool_)
        self._is_pose[:p] = nominal.is_pose
        products = noise.products(np.hstack(blocks), nominal.residual)
        self._plain = noise.plain(products)
        self._field = noise.with_field(products) if noise.has_field else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(self._columns)

    def log_evidence(self, effects: tuple[str, ...]) -> float:
        """Return the log evidence for effects acting together, averaged over places and noise."""
        return self._average(self._plain, effects)

    def hypothesis(self, effects: tuple[str, ...]) -> Hypothesis:
        """Return the evidence for effects acting together, with and without the smooth field."""
        alone = self.log_evidence(effects)
        if self._field is None:
            return Hypothesis(effects, alone)
        return Hypothesis(effects, alone, self._average(self._field, effects) - alone)

    def _average(self, q: Quadratic, effects: tuple[str, ...]) -> float:
        places = list(product(*(self._columns[name] for name in effects)))
        found = [self._at(q, places[i : i + AT_ONCE]) for i in range(0, len(places), AT_ONCE)]
        return float(logsumexp(found) - np.log(len(places)))

    def _at(self, q: Quadratic, places: Sequence[tuple[IntArray, ...]]) -> float:
        """Return the log of the evidence summed over places, noise states and pose scales."""
        which = np.array([np.concatenate([self._nominal, *place]) for place in places])
        any_place = which[0]
        freed = with_pose_scales(q.of(which), self._is_pose[any_place])
        found = log_marginal(freed, self._offset[any_place], self._sided[any_place])
        return float(logsumexp(found))
