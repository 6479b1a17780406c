"""From the nominal analysis to a verdict: fit the suspects, fit pairs of them, weigh.

::

    nominal analysis --> joint fits of single effects --> joint fits of pairs --> verdict
                           (each joint fit is independent of the others)

`diagnose` is a generator: it yields the joint fits that it wants and is sent them. Who fits,
where, and whether a fit is stored already is no business of this file.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from workers.diagnosis.alarm_threshold import alarm_threshold, null_alarms
from workers.diagnosis.evidence import log_evidence
from workers.diagnosis.hypotheses import Hypothesis
from workers.diagnosis.inverse_problem import InverseProblem
from workers.diagnosis.joint_evidence import JointEvidence
from workers.diagnosis.joint_fit import JointFit
from workers.diagnosis.nominal_analysis import NominalAnalysis
from workers.diagnosis.screening import screen
from workers.diagnosis.settings import SETTINGS
from workers.diagnosis.verdict import Verdict, verdict
from workers.mechanics.effects.base import Effect

Combination = tuple[Effect, ...]
"""Effects that are fitted together with the constants."""

Course = Generator[Sequence[Combination], Sequence[JointFit | None], "Diagnosis"]
"""Yields combinations whose joint fits are wanted; is sent these in their order, None for one
that could not be simulated; returns the diagnosis."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and all that it rests on.

    Parameters
    ----------
    analysis : NominalAnalysis
    verdict : Verdict
    joint_fits : dict of tuple of str to JointFit
        By the names of the effects, in the order in which they were asked for.
    hypotheses : tuple of Hypothesis
    """

    analysis: NominalAnalysis
    verdict: Verdict
    joint_fits: dict[tuple[str, ...], JointFit]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def best(self) -> JointFit | None:
        """The joint fit of the effects that are accused."""
        accused = set(self.verdict.primary)
        for names, fitted in self.joint_fits.items():
            if set(names) == accused:
                return fitted
        return None


def diagnose(analysis: NominalAnalysis, effects: Sequence[Effect]) -> Course:
    """Have the suspects fitted, and weigh them against each other.

    Parameters
    ----------
    analysis : NominalAnalysis
    effects : sequence of Effect
        The catalogue.
    """
    known = {e.name: e for e in effects}
    joint_fits: dict[tuple[str, ...], JointFit] = {}
    singles: list[Combination] = [(e,) for e in suspects(analysis, known)]
    if singles:
        joint_fits |= _by_names((yield singles))
    pairs = _pairs(analysis, known, list(joint_fits.values()))
    if pairs:
        joint_fits |= _by_names((yield pairs))
    hypotheses = weigh(analysis, joint_fits)
    families = {one.name: known[one.name].family for one in analysis.sensitivities}
    reached = verdict(hypotheses, families, threshold_of(analysis), analysis.hidden)
    return Diagnosis(analysis, reached, joint_fits, hypotheses)


def advance(
    course: Course, joint_fits: Sequence[JointFit | None] | None = None
) -> Sequence[Combination] | Diagnosis:
    """Take a diagnosis to where it wants joint fits again, or to its end.

    Parameters
    ----------
    course : generator
        See `diagnose`.
    joint_fits : sequence of JointFit or None, optional
        Those that it wanted; nothing begins it.
    """
    try:
        return next(course) if joint_fits is None else course.send(joint_fits)
    except StopIteration as end:
        diagnosis: Diagnosis = end.value
        return diagnosis


def suspects(analysis: NominalAnalysis, known: dict[str, Effect]) -> list[Effect]:
    """Return the effects that are worth a joint fit, the most suspicious first."""
    visible = [one for one in analysis.screening if not one.hides]
    if not visible:
        return []
    best = visible[0].log_bayes_factor
    least = max(
        min(best - SETTINGS.joint_fits.far_behind, SETTINGS.joint_fits.nearly * best),
        SETTINGS.joint_fits.least_gain,
    )
    near = [one for one in visible if one.log_bayes_factor > least]
    return [known[one.name] for one in near[: SETTINGS.joint_fits.singles]]


def partners(analysis: NominalAnalysis, known: dict[str, Effect], best: JointFit) -> list[Effect]:
    """Return the effects that speak from what the best one leaves.

    They are judged by their sensitivities at the nominal fit.
    """
    others = [one for one in analysis.sensitivities if one.name not in best.names]
    left = screen(best.fit.linearised(analysis.inverse), others)
    loud = [
        one
        for one in left
        if not one.hides and one.log_bayes_factor > SETTINGS.joint_fits.second_gain
    ]
    return [known[one.name] for one in loud[: SETTINGS.joint_fits.partners]]


def weigh(
    analysis: NominalAnalysis, joint_fits: dict[tuple[str, ...], JointFit]
) -> tuple[Hypothesis, ...]:
    """Return the evidence of every hypothesis: of a joint fit, else of the linear model."""
    linear, field = analysis.linear, analysis.field
    joint = JointEvidence(linear, analysis.sensitivities, field)
    nothing = log_evidence(linear)
    weighed = [Hypothesis((), nothing, field.log_evidence(linear) - nothing)]
    alone = ((one.name,) for one in analysis.sensitivities)
    weighed += [joint.hypothesis(effects) for effects in alone if effects not in joint_fits]
    for names, fitted in joint_fits.items():
        at = fitted.fit.linearised(analysis.inverse)
        one_sided = fitted.fit.unknowns.one_sided
        plain = log_evidence(at, one_sided)
        weighed.append(Hypothesis(names, plain, field.log_evidence(at, one_sided) - plain))
    return tuple(weighed)


def threshold_of(analysis: NominalAnalysis) -> float:
    """Return the log evidence against no gap below which there is no alarm, in nats."""
    settings, sensitivities = SETTINGS.alarm, analysis.sensitivities
    alarms = null_alarms(
        analysis.linear, sensitivities, settings.seed, settings.replicates, analysis.field
    )
    one_direction = directions_of(analysis.inverse) == 1
    least = settings.least_one_direction if one_direction else settings.least_more_directions
    return max(least, alarm_threshold(alarms, settings.false_alarm_rate))


def directions_of(inverse: InverseProblem) -> int:
    """Return in how many directions the body was loaded."""
    middle = {constant.name: math.exp(constant.log_mean) for constant in inverse.free}
    direction = inverse.forward.direction
    axes = np.array([direction(scan.problem(middle)) for scan in inverse.scans], float)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    same = np.abs(axes @ axes.T) > SETTINGS.alarm.same_direction_cosine
    return len({tuple(row) for row in same.tolist()})


def _by_names(fitted: Sequence[JointFit | None]) -> dict[tuple[str, ...], JointFit]:
    return {one.names: one for one in fitted if one is not None}


def _pairs(
    analysis: NominalAnalysis, known: dict[str, Effect], singles: Sequence[JointFit]
) -> list[Combination]:
    """Return pairs that are worth a joint fit: the best effect with what speaks from what it
    leaves; all pairs of the best ones if a smooth field explains what is left."""
    ranked = sorted(singles, key=lambda one: -one.log_evidence)[: SETTINGS.joint_fits.partners]
    if not ranked:
        return []
    best = ranked[0]
    pairs: list[Combination] = [(*best.effects, e) for e in partners(analysis, known, best)]
    if _is_unexplained(analysis, best):
        tried = {frozenset(e.name for e in pair) for pair in pairs}
        for a, b in combinations(ranked, 2):
            if {*a.names, *b.names} not in tried:
                pairs.append((*a.effects, *b.effects))
    return pairs


def _is_unexplained(analysis: NominalAnalysis, best: JointFit) -> bool:
    """Return whether the best effect alone leaves something that a smooth field explains."""
    at = best.fit.linearised(analysis.inverse)
    one_sided = best.fit.unknowns.one_sided
    return (
        analysis.field.log_evidence(at, one_sided) - best.log_evidence
        > SETTINGS.joint_fits.left_over
    )
