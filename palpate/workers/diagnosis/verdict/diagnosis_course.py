"""The sequence from nominal analysis to verdict: fit suspects, add further effects, name causes.

::

    nominal analysis --> fits of single effects --> of the best with others --> of three --> verdict
                         (each fit is independent of the others of its kind)

If no effect is named although something gains, every visible effect is fitted before the verdict:
screening can miss a motion shared by all scans, or an effect that changes the constants.

`diagnose` is a generator: it yields requests for joint fits and receives the fits. The caller
decides who computes a fit and whether a stored one is used.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.storage.values import BoolArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, screen
from palpate.workers.diagnosis.fits.gauss_newton import DataPart
from palpate.workers.diagnosis.linearisation import factored
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.verdict.cause_selection import (
    MOST_EFFECTS,
    NONE_OF_THESE,
    Verdict,
    selected,
    verdict,
)
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.mechanics.effects.effect import Effect

Catalogue = Mapping[str, Effect]
"""Effects by their names."""

Combination = tuple[Effect, ...]
"""Effects fitted together with the constants."""

Wanted = Sequence[Combination]
Answer = Sequence[JointFit | None]
Fits = dict[tuple[str, ...], JointFit]
Course = Generator[Wanted, Answer, "Diagnosis"]
"""Generator that yields combinations to be fitted, receives the fits in the same order, None for a
combination that could not be simulated, and returns the diagnosis."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and everything on which it is based.

    Parameters
    ----------
    analysis : NominalAnalysis
    verdict : Verdict
    joint_fits : dict of tuple of str to JointFit
        Joint fits by the names of their effects, in the order requested.
    """

    analysis: NominalAnalysis
    verdict: Verdict
    joint_fits: Fits

    @property
    def best(self) -> JointFit | None:
        """The joint fit of the named effects."""
        named = set(self.verdict.primary)
        for names, fitted in self.joint_fits.items():
            if set(names) == named:
                return fitted
        return None

    def chosen_on(self, rows: BoolArray) -> tuple[str, ...]:
        """Return the effects that some of the residuals, a mask of shape (m,), name.

        Only effects that were fitted to all of them can be named; see `Fit.log_evidence`.
        """
        analysis = self.analysis
        inverse = analysis.inverse
        covariance = analysis.linear_with_poses.covariance
        part = DataPart(rows, factored(covariance[np.ix_(rows, rows)]))
        nominal = analysis.nominal.log_evidence(inverse, part=part)
        gains = {
            names: one.fit.log_evidence(inverse, part=part) - nominal
            for names, one in self.joint_fits.items()
        }
        return selected(gains, analysis.hidden, *thresholds(analysis.inverse))

    def gain(self, names: tuple[str, ...]) -> float:
        """Return the gain in log evidence of a fit over the nominal model, in nats."""
        return self.joint_fits[names].log_evidence - self.analysis.log_evidence


def diagnose(analysis: NominalAnalysis, effects: Sequence[Effect]) -> Course:
    """Request fits of the suspects and name causes.

    Parameters
    ----------
    analysis : NominalAnalysis
    effects : sequence of Effect
        The catalogue.
    """
    known = {e.name: e for e in effects}
    asked: set[frozenset[str]] = set()
    fits = yield from _fitted([(e,) for e in suspects(analysis, known)], asked)
    fits = yield from _extended(analysis, known, fits, asked)
    reached = _verdict(analysis, fits)
    if reached.kind == NONE_OF_THESE:
        visible = [result.name for result in analysis.screening if not result.hides]
        fits |= yield from _fitted([(known[name],) for name in visible], asked)
        fits = yield from _extended(analysis, known, fits, asked)
        reached = _verdict(analysis, fits)
    return Diagnosis(analysis, reached, fits)


def advance(course: Course, answer: Answer | None = None) -> Wanted | Diagnosis:
    """Advance a diagnosis to its next request or to its end.

    Parameters
    ----------
    course : generator
        See `diagnose`.
    answer : sequence of JointFit or None, optional
        The answer to the last request; None to start.
    """
    try:
        return next(course) if answer is None else course.send(answer)
    except StopIteration as end:
        diagnosis: Diagnosis = end.value
        return diagnosis


def base_of(effects: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of the effects whose joint fit is the starting point: all but the last.

    A combination is requested after the combination that it extends.
    """
    return tuple(effect.name for effect in effects[:-1])


def suspects(analysis: NominalAnalysis, known: Catalogue) -> list[Effect]:
    """Return the effects that are worth a joint fit, the most probable first.

    If the nominal model is far off, one effect that the linear model underestimates is added.
    """
    settings = SETTINGS.joint_fits
    visible = [result for result in analysis.screening if not result.hides]
    loud = [result for result in visible if result.log_bayes_factor > settings.least_gain]
    near = loud[: settings.singles]
    if visible and visible[0].log_bayes_factor > settings.far_off:
        steep = (r for r in loud[settings.singles :] if analysis.is_steep(known[r.name]))
        near += [*steep][:1]
    return [known[result.name] for result in near]


def extensions(analysis: NominalAnalysis, known: Catalogue, fitted: JointFit) -> list[Combination]:
    """Return the extensions of a joint fit by one effect that its residuals support, best first.

    The support is computed from the sensitivities at the nominal fit.
    """
    settings = SETTINGS.joint_fits
    excluded = {*fitted.names, *analysis.hidden}
    others = [one for one in analysis.sensitivities if one.name not in excluded]
    at = fitted.fit.linearised(analysis.inverse).holding(fitted.fit.at_bound != 0)
    least = settings.second_share * thresholds(analysis.inverse).further
    loud = [
        result
        for result in screen(at, others)
        if not result.hides and result.log_bayes_factor > least
    ]
    return [(*fitted.effects, known[one.name]) for one in loud[: settings.partners]]


def gains_of(
    analysis: NominalAnalysis, fits: Mapping[tuple[str, ...], JointFit]
) -> dict[tuple[str, ...], float]:
    """Return the gains of joint fits over the nominal model, in nats."""
    return {names: fit.log_evidence - analysis.log_evidence for names, fit in fits.items()}


def _extended(
    analysis: NominalAnalysis, known: Catalogue, fits: Fits, asked: set[frozenset[str]]
) -> Generator[Wanted, Answer, Fits]:
    """Request extensions of the selected effects as long as one of them is selected."""
    before: tuple[str, ...] = ()
    while True:
        names = selected(gains_of(analysis, fits), analysis.hidden, *thresholds(analysis.inverse))
        if names == before or len(names) == MOST_EFFECTS:
            return fits
        chosen = next(fit for who, fit in fits.items() if set(who) == set(names))
        fits = fits | (yield from _fitted(extensions(analysis, known, chosen), asked))
        before = names


def _verdict(analysis: NominalAnalysis, fits: Fits) -> Verdict:
    gains = gains_of(analysis, fits)
    names = selected(gains, analysis.hidden, *thresholds(analysis.inverse))
    chosen = next((fit.fit for who, fit in fits.items() if names and set(who) == set(names)), None)
    left = analysis.field_gain(analysis.nominal if chosen is None else chosen)
    return verdict(gains, left, analysis.hidden, *thresholds(analysis.inverse))


class Thresholds(NamedTuple):
    """Least gains of a further cause and of the first one, in nats."""

    further: float
    first: float


def thresholds(inverse: InverseProblem) -> Thresholds:
    """Return the thresholds; where the noise is known, no error is common to all points."""
    settings = SETTINGS.selection
    if inverse.is_segmented:
        return Thresholds(settings.further, settings.first)
    return Thresholds(settings.further_measured, settings.first_measured)


def _fitted(
    combinations: Sequence[Combination], asked: set[frozenset[str]]
) -> Generator[Wanted, Answer, Fits]:
    """Request fits of combinations that were not `asked` for before; return them by their names."""
    new = [one for one in combinations if frozenset(e.name for e in one) not in asked]
    asked |= {frozenset(effect.name for effect in one) for one in new}
    answer = (yield new) if new else []
    return {one.names: one for one in answer if one is not None}
