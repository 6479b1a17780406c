"""The constants and the parameters of some effects, fitted again together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from storage.values import FloatArray
from workers.diagnosis.evidence import log_evidence
from workers.diagnosis.fingerprint import Fingerprint
from workers.diagnosis.fingerprints import Places
from workers.diagnosis.fit import Fit, fit
from workers.diagnosis.screen import Finding
from workers.diagnosis.subject import Subject, unknowns
from workers.effects.base import Effect, one_sided
from workers.effects.inclusion import INCLUSION, PLACE, RATIO

# Where a refit begins, as a part of what the screening expects. A one-sided parameter, whose
# secant was taken, begins where that expects it.
START = 0.5
# But not nearer to zero than this part of its prior standard deviation, where it is steepest.
LEAST = 0.1
# Best places from which the fit of a lump begins.
STARTS = 2


@dataclass(frozen=True, eq=False)
class Refit:
    """A hypothesis with effects at its optimum."""

    effects: tuple[Effect, ...]
    fit: Fit
    log_evidence: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(e.name for e in self.effects)


def refit(
    subject: Subject,
    near: Fit,
    effects: Sequence[Effect],
    findings: Mapping[str, Finding],
    prints: Mapping[str, Fingerprint],
    places: Places,
) -> Refit | None:
    """Fit constants and effects, from the best places where an effect has one.

    Parameters
    ----------
    subject : Subject
    near : Fit
        Of the nominal model, or with some of the effects.
    effects : sequence of Effect
    findings : mapping of str to Finding
        What the screening expects of those that `near` has not.
    prints : mapping of str to Fingerprint
    places : Places

    Returns
    -------
    Refit or None
        None if no start could be simulated.
    """
    best: Refit | None = None
    for start in _starts(subject, near, effects, findings, places):
        found = _from(subject, near, effects, start, prints)
        if found is not None and (best is None or found.log_evidence > best.log_evidence):
            best = found
    return best


def _from(
    subject: Subject,
    near: Fit,
    effects: Sequence[Effect],
    start: Mapping[str, float],
    prints: Mapping[str, Fingerprint],
) -> Refit | None:
    free = unknowns(subject.free, effects)
    known = near.values() | dict(start)
    z = np.array([known[name] for name in free.names])
    k = len(subject.free)
    z[:k] = np.log(z[:k])
    new = [e for e in effects if e not in near.unknowns.effects]
    z[:k] += _compensation(subject, near, new, start, prints)
    found = fit(subject, free, z, near.starts())
    if found is None:
        return None
    evidence = log_evidence(found.linearised(subject), free.one_sided)
    return Refit(tuple(effects), found, evidence)


def _compensation(
    subject: Subject,
    near: Fit,
    new: Sequence[Effect],
    start: Mapping[str, float],
    prints: Mapping[str, Fingerprint],
) -> FloatArray:
    """Change of the logarithms of the constants that takes up most of what effects do."""
    k = len(subject.free)
    done = np.zeros(len(near.jacobian))
    for effect in new:
        known = prints[effect.name].places[0]
        if effect is INCLUSION or known.shape[1] != len(effect.names):
            continue
        away = [start[name] - effect.neutral[name] for name in effect.names]
        done += known @ np.array(away)
    at = near.linearised(subject)
    A = at.scaled_nominal[:, :k]
    step = np.linalg.solve(np.eye(k) + A.T @ A, A.T @ at.whiten(done))
    return np.asarray(-np.clip(step, -2.0, 2.0) * at.nominal_sd[:k])


def _starts(
    subject: Subject,
    near: Fit,
    effects: Sequence[Effect],
    findings: Mapping[str, Finding],
    places: Places,
) -> list[dict[str, float]]:
    new = [e for e in effects if e not in near.unknowns.effects]
    common: dict[str, float] = {}
    for effect in new:
        if effect is not INCLUSION:
            common |= _expected(effect, findings[effect.name].estimate)
    if INCLUSION not in new:
        return [common]
    finding = findings[INCLUSION.name]
    ranked = np.argsort(-finding.place_log_bayes_factors)[:STARTS]
    starts = []
    for place in ranked:
        offset = dict(zip(PLACE, map(float, places.offsets[place]), strict=True))
        ratio = float(np.clip(START * finding.estimate[0], -1.0, 1.0)) or 0.1
        starts.append(common | INCLUSION.neutral | offset | {RATIO: ratio})
    return starts


def _expected(effect: Effect, estimate: FloatArray) -> dict[str, float]:
    if effect.if_present:
        return {n: mean for n, (mean, _) in zip(effect.names, effect.if_present, strict=True)}
    start = {}
    for p, sd, value in zip(effect.parameters, effect.prior_sd, estimate, strict=True):
        neutral = effect.neutral[p.name]
        if one_sided(p):
            start[p.name] = neutral + float(np.clip(value, LEAST * sd, 1.5 * sd))
        else:
            start[p.name] = neutral + float(np.clip(START * value, -1.5 * sd, 1.5 * sd))
    return start
