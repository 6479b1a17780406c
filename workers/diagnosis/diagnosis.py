"""From a subject to a verdict: calibrate, look at every effect, refit the suspects, weigh.

::

    calibrate --> look --> refit the best single effects --> refit pairs --> weigh
                                   (each refit is independent of the others)
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType

import numpy as np

from workers.diagnosis.discrepancy import Discrepancy
from workers.diagnosis.evidence import log_evidence
from workers.diagnosis.fingerprint import Fingerprint
from workers.diagnosis.fingerprints import Places, fingerprints
from workers.diagnosis.fit import Fit
from workers.diagnosis.hypotheses import Hypothesis
from workers.diagnosis.joint import JointEvidence
from workers.diagnosis.linear import Linearised
from workers.diagnosis.refit import Refit, refit
from workers.diagnosis.screen import Finding, screen
from workers.diagnosis.subject import Subject
from workers.diagnosis.threshold import alarm_threshold, null_alarms
from workers.diagnosis.verdict import Verdict, verdict
from workers.effects.base import Effect

# Single effects that are refitted: the best by screening.
SINGLES = 5
# The best of them are paired with each other.
PARTNERS = 3
# An effect this far behind the best one by screening is not refitted, in nats.
FAR_BEHIND = 60.0
# But one that gains this part of what the best one gains is: where data are much finer than
# the effects, the linear model errs by more than that.
NEARLY = 0.5
# Nor is one that the data speak against, in nats.
LEAST = 0.0
# Pairs are refitted if a smooth field gains this much on top of the best effect, in nats.
LEFT_OVER = 1.0
# So is one with an effect that gains this much on top of it, as it looked alone.
SECOND = 3.0
# Cosine of two directions that are one.
ALIKE = 0.9
FALSE_ALARMS = 0.02
NULL_DRAWS = 400
# No alarm below this, in nats, by the directions in which a body was pressed: one, or more.
# Linear replicates say some 3. The bodies of another solver know better; see docs/blind.md.
LEAST_ALARM = MappingProxyType({1: 11.0, 2: 7.0})

RefitMany = Callable[[Sequence[tuple[Effect, ...]]], Iterable[Refit | None]]


@dataclass(frozen=True, eq=False)
class Look:
    """What the nominal fit alone tells.

    Parameters
    ----------
    subject : Subject
    nominal : Fit
    linear : Linearised
    prints : dict of str to Fingerprint
    places : Places
    findings : tuple of Finding
        The largest Bayes factor first.
    field : Discrepancy
    threshold : float
        Alarm that a case without any effect should seldom exceed; see `threshold_of`.
    """

    subject: Subject
    nominal: Fit
    linear: Linearised
    prints: dict[str, Fingerprint]
    places: Places
    findings: tuple[Finding, ...]
    field: Discrepancy
    threshold: float

    @property
    def by_name(self) -> dict[str, Finding]:
        """Findings by the name of the effect."""
        return {f.name: f for f in self.findings}

    def hiding(self) -> set[str]:
        """Effects that the constants hide."""
        return {f.name for f in self.findings if f.hides}


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and all that it stands on."""

    look: Look
    verdict: Verdict
    refits: dict[tuple[str, ...], Refit]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def best(self) -> Refit | None:
        """The refit of the effects that are accused."""
        wanted = set(self.verdict.primary)
        for names, found in self.refits.items():
            if set(names) == wanted:
                return found
        return None


def look(subject: Subject, nominal: Fit, effects: Sequence[Effect], seed: int = 0) -> Look:
    """See what every effect would do, and how loud noise alone would be."""
    linear = nominal.linearised(subject)
    prints, places = fingerprints(subject, nominal, effects)
    field = discrepancy_of(subject, nominal)
    return Look(
        subject,
        nominal,
        linear,
        {p.name: p for p in prints},
        places,
        screen(linear, prints),
        field,
        threshold_of(subject, linear, prints, field, seed),
    )


def threshold_of(
    subject: Subject,
    linear: Linearised,
    prints: Sequence[Fingerprint],
    field: Discrepancy,
    seed: int = 0,
) -> float:
    """Log evidence against no gap below which there is no alarm."""
    alarms = null_alarms(linear, prints, seed, NULL_DRAWS, field)
    least = LEAST_ALARM[min(directions_of(subject), max(LEAST_ALARM))]
    return max(least, alarm_threshold(alarms, FALSE_ALARMS))


def directions_of(subject: Subject) -> int:
    """In how many directions the body of a subject was loaded."""
    middle = {f.name: math.exp(f.log_mean) for f in subject.free}
    axes = np.array([scan.problem(middle).load.device.axis for scan in subject.scans], float)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    alike = np.abs(axes @ axes.T) > ALIKE
    return len({tuple(row) for row in alike.tolist()})


def diagnose(seen: Look, effects: Sequence[Effect], refits: RefitMany) -> Diagnosis:
    """Refit the suspects and weigh them against each other.

    Parameters
    ----------
    seen : Look
    effects : sequence of Effect
        The catalogue.
    refits : callable
        From combinations of effects to refits, in their order; `one_by_one` or a cluster.
    """
    known = {e.name: e for e in effects}
    singles = suspects(seen, known)
    found: dict[tuple[str, ...], Refit] = {}
    for refitted in refits([(e,) for e in singles]):
        if refitted is not None:
            found[refitted.names] = refitted
    ranked = sorted(found.values(), key=lambda r: -r.log_evidence)[:PARTNERS]
    pairs: list[tuple[Effect, ...]] = []
    if ranked:
        pairs = [(*ranked[0].effects, e) for e in partners(seen, known, ranked[0])]
    if ranked and _unexplained(seen, ranked[0]):
        tried = {frozenset(e.name for e in pair) for pair in pairs}
        for a, b in combinations(ranked, 2):
            if {*a.names, *b.names} not in tried:
                pairs.append((*a.effects, *b.effects))
    for refitted in refits(pairs):
        if refitted is not None:
            found[refitted.names] = refitted
    hypotheses = weigh(seen, found)
    families = {name: known[name].family for name in seen.prints}
    said = verdict(hypotheses, families, seen.threshold, seen.hiding())
    return Diagnosis(seen, said, found, hypotheses)


def partners(seen: Look, known: dict[str, Effect], best: Refit) -> list[Effect]:
    """Effects that what the best one leaves speaks for, as they looked at the nominal fit."""
    others = [p for p in seen.prints.values() if p.name not in best.names]
    left = screen(best.fit.linearised(seen.subject), others)
    loud = [f for f in left if not f.hides and f.log_bayes_factor > SECOND]
    return [known[f.name] for f in loud[:PARTNERS]]


def _unexplained(seen: Look, best: Refit) -> bool:
    """Whether the best effect alone leaves something that a smooth field would explain."""
    at = best.fit.linearised(seen.subject)
    one_sided = best.fit.unknowns.one_sided
    return seen.field.log_evidence(at, one_sided) - best.log_evidence > LEFT_OVER


def suspects(seen: Look, known: dict[str, Effect]) -> list[Effect]:
    """The effects worth a refit, the most suspicious first."""
    open_ones = [f for f in seen.findings if not f.hides]
    if not open_ones:
        return []
    best = open_ones[0].log_bayes_factor
    least = max(min(best - FAR_BEHIND, NEARLY * best), LEAST)
    near = [f for f in open_ones if f.log_bayes_factor > least]
    return [known[f.name] for f in near[:SINGLES]]


def one_by_one(seen: Look) -> RefitMany:
    """Refit in this process."""

    def run(asked: Sequence[tuple[Effect, ...]]) -> Iterable[Refit | None]:
        for effects in asked:
            yield refit(seen.subject, seen.nominal, effects, seen.by_name, seen.prints, seen.places)

    return run


def weigh(seen: Look, refits: dict[tuple[str, ...], Refit]) -> tuple[Hypothesis, ...]:
    """Evidence of every hypothesis: of a refit where there is one, else of the linear model."""
    joint = JointEvidence(seen.linear, list(seen.prints.values()), seen.field)
    nothing = log_evidence(seen.linear)
    weighed = [Hypothesis((), nothing, seen.field.log_evidence(seen.linear) - nothing)]
    for name in seen.prints:
        if (name,) not in refits:
            evidence = float(joint.log_evidence((name,))[0])
            gain = joint.discrepancy_gain((name,))
            weighed.append(Hypothesis((name,), evidence, None if gain is None else float(gain[0])))
    for names, found in refits.items():
        at = found.fit.linearised(seen.subject)
        one_sided = found.fit.unknowns.one_sided
        plain = log_evidence(at, one_sided)
        gain_there = seen.field.log_evidence(at, one_sided) - plain
        weighed.append(Hypothesis(names, plain, gain_there))
    return tuple(weighed)


def discrepancy_of(subject: Subject, at: Fit) -> Discrepancy:
    """The smooth field that stands for something else."""
    normals = np.concatenate([v.normals for v in at.views])
    points = np.tile(subject.points.points, (len(subject.scans), 1))
    return Discrepancy(points, normals, subject.rows, subject.covariance_factor)
