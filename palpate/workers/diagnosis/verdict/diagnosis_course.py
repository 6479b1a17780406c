"""The sequence from nominal analysis to verdict: fit suspects, fit combinations, weigh.

::

    nominal analysis --> joint fits of single effects --> of pairs --> of three --> verdict
                           |            ^  (each joint fit is independent of the others)
                           v            |
                       second reading of the noise, if the best fit is far from the nominal fit

Every effect that the verdict names is fitted, and all hypotheses are weighed again: screening can
miss a motion shared by all scans, which the poses absorb scan by scan. Before the verdict is "none
of these", every visible effect is fitted. An effect that the constants hide but that the data still
support is fitted too, alone and together with the best visible effect; otherwise it could be taken
for the cause of residuals that another effect leaves unexplained.

`diagnose` is a generator: it yields requests for joint fits and receives the fits, or yields a
request for a second reading and receives the new analysis. The caller decides who computes a fit
and whether a stored one is used.

The second reading (`read_again`) estimates the noise at the points predicted by the best single
effect. The first estimate uses the points predicted by the nominal model. If that model is wrong by
more than the amplitude or correlation length of the noise, these points are off the interfaces or
on other parts of them, and the model error has been mistaken for noise. The best single effect is
closer to the truth even if it is not the true cause, so the noise is estimated again there, and all
hypotheses are weighed with the new estimate.
"""

from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis, screen
from palpate.workers.diagnosis.fits.gauss_newton import Fit, fit
from palpate.workers.diagnosis.fits.model_errors import acting_or_alike
from palpate.workers.diagnosis.fits.nominal_calibration import (
    with_anchored_scans,
    with_learnt_noise,
)
from palpate.workers.diagnosis.problem.inverse_problem import Scan
from palpate.workers.diagnosis.problem.scan_prediction import (
    PredictedScan,
    compare_with_scan,
    compared_points,
    predict_scan,
    registered,
)
from palpate.workers.diagnosis.verdict.hypotheses import (
    MOST_EFFECTS,
    Hypothesis,
    JointEvidence,
    PriorOdds,
)
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.diagnosis.verdict.verdict import Verdict, verdict
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium

Catalogue = Mapping[str, Effect]
"""Effects by their names."""

Combination = tuple[Effect, ...]
"""Effects fitted together with the constants."""


def suspects(analysis: NominalAnalysis, known: Catalogue) -> list[Effect]:
    """Return the effects that are worth a joint fit, the most probable first.

    If the nominal model is far off, one effect that the linear model underestimates is added.
    """
    settings = SETTINGS.joint_fits
    visible = [result for result in analysis.screening if not result.hides]
    if not visible:
        return []
    best = visible[0].log_bayes_factor
    least = max(min(best - settings.far_behind, settings.nearly * best), settings.least_gain)
    near = [result for result in visible if result.log_bayes_factor > least][: settings.singles]
    if best > settings.far_off:
        loud = [result for result in visible if result.log_bayes_factor > settings.least_gain]
        steep = (
            result
            for result in loud
            if result not in near and analysis.is_steep(known[result.name])
        )
        near += [*steep][:1]
    return [known[result.name] for result in near]


def pairs(
    analysis: NominalAnalysis, known: Catalogue, fits: Sequence[JointFit]
) -> list[Combination]:
    """Return pairs that are worth a joint fit.

    These are the best effect with each effect that its residuals support; other effects with the
    effects that their residuals support, if the expected evidence is higher; and all pairs of the
    best effects, if a smooth field explains the residuals of the best one.
    """
    near = ranked(candidate for candidate in fits if len(candidate.effects) == 1)[
        : SETTINGS.joint_fits.partners
    ]
    if not near:
        return []
    best, *others = near
    own = _extended(analysis, known, best)
    selection = {candidate.names: candidate.effects for candidate in own}
    unexplained = _is_unexplained(analysis, best)
    if own or unexplained:
        most = max((candidate.promise for candidate in own), default=best.log_evidence)
        more = [candidate for other in others for candidate in _extended(analysis, known, other)]
        more = sorted(more, key=lambda one: -one.promise)[: SETTINGS.joint_fits.partners]
        selection = {
            candidate.names: candidate.effects for candidate in more if candidate.promise > most
        } | selection
    if unexplained:
        for a, b in combinations(near, 2):
            selection.setdefault(frozenset((*a.names, *b.names)), (*a.effects, *b.effects))
    return list(selection.values())


def triples(
    analysis: NominalAnalysis, known: Catalogue, fits: Sequence[JointFit]
) -> list[Combination]:
    """Return the best two effects with each effect that their residuals support.

    There are no triples if a single effect is better than all pairs.
    """
    best = ranked(one for one in fits if len(one.effects) < MOST_EFFECTS)[:1]
    if not best or len(best[0].effects) < MOST_EFFECTS - 1:
        return []
    extended = _extended(analysis, known, best[0])
    return [one.effects for one in extended[: SETTINGS.joint_fits.thirds]]


def ranked(fits: Iterable[JointFit]) -> list[JointFit]:
    """Return joint fits in order of decreasing evidence."""
    return sorted(fits, key=lambda one: -one.log_evidence)


def near_best(fits: Sequence[JointFit]) -> list[JointFit]:
    """Return the ranked fits that are not far behind the best fit."""
    least = fits[0].log_evidence - SETTINGS.joint_fits.far_behind
    return [one for one in fits if one.log_evidence >= least]


class _Extended(NamedTuple):
    """Fitted effects with one more effect, and the log evidence expected from screening."""

    effects: Combination
    promise: float

    @property
    def names(self) -> frozenset[str]:
        return frozenset(effect.name for effect in self.effects)


def _extended(analysis: NominalAnalysis, known: Catalogue, fitted: JointFit) -> list[_Extended]:
    """Return the extensions of a joint fit by one effect that its residuals support, best first.

    The support is computed from the sensitivities at the nominal fit.
    """
    others = [one for one in analysis.sensitivities if one.name not in fitted.names]
    at = fitted.fit.linearised(analysis.inverse).holding(fitted.fit.at_bound != 0)
    least = SETTINGS.joint_fits.second_gain / analysis.inverse.coarsening
    loud = [one for one in screen(at, others) if not one.hides and one.log_bayes_factor > least]
    return [
        _Extended((*fitted.effects, known[one.name]), fitted.log_evidence + one.log_bayes_factor)
        for one in loud[: SETTINGS.joint_fits.partners]
    ]


def _is_unexplained(analysis: NominalAnalysis, best: JointFit) -> bool:
    """Return True if a smooth field explains the residuals of the best single effect."""
    gain = analysis.noise.field_gain(analysis.hypothesis(best.fit))
    least = SETTINGS.joint_fits.left_over / analysis.inverse.coarsening
    return gain is not None and gain > least


def is_elsewhere(analysis: NominalAnalysis, best: Fit) -> bool:
    """Return True if a fit moves the points far enough to change the noise estimate.

    The root mean square shift from the nominal points is compared with the standard deviation of
    the noise across the interfaces and with its correlation length along them.
    """
    inverse, nominal = analysis.inverse, analysis.nominal
    if not inverse.is_segmented:
        return False
    shift = nominal.residual(inverse) - best.residual(inverse)
    across = analysis.registered(shift) / inverse.noise.sd_mm
    before, after = (np.concatenate([v.points for v in f.predictions]) for f in (nominal, best))
    normals, moves = np.concatenate([v.normals for v in nominal.predictions]), after - before
    sliding = moves - (moves * normals).sum(axis=1)[:, None] * normals
    along = np.linalg.norm(sliding, axis=1) / inverse.noise.correlation_mm
    return bool((across**2 + along**2).mean() > SETTINGS.noise.elsewhere**2)


def read_again(
    analysis: NominalAnalysis, singles: Sequence[JointFit], best: JointFit, each: Each = map
) -> NominalAnalysis:
    """Estimate the noise again at the best single effect, and refit the constants alone.

    Parameters
    ----------
    analysis : NominalAnalysis
    singles : sequence of JointFit
        All fitted single effects.
    best : JointFit
        Best of the single effects.
    each : callable
        Applies a function to every scan; see `workers.diagnosis.fits.gauss_newton.fit`.

    Returns
    -------
    NominalAnalysis
        The new analysis, with the sensitivities of the first analysis.
    """
    inverse, nominal = analysis.inverse, analysis.nominal
    begun = {prediction.names[0]: prediction.fit.values() for prediction in singles}
    u, z = best.fit.unknowns, best.fit.z

    def predicted(scan: Scan, start: Equilibrium) -> PredictedScan | None:
        return predict_scan(inverse, scan, u, z, start)

    predictions = list(each(predicted, inverse.scans, nominal.starts()))
    solved = [prediction for prediction in predictions if prediction is not None]
    if len(solved) < len(predictions):
        return replace(analysis, begun=begun)
    lying = registered(inverse, u, z, solved)
    anchors = [
        compared_points(inverse, u, z, prediction.points, prediction.pose) for prediction in lying
    ]
    inverse = with_anchored_scans(inverse, anchors)
    compared = [
        compare_with_scan(inverse, scan, u, z, prediction.at, prediction.pose)
        for scan, prediction in zip(inverse.scans, lying, strict=True)
    ]
    inverse = with_learnt_noise(inverse, best.fit.jacobian * u.sd, compared)
    free = nominal.unknowns
    again = fit(inverse, free, nominal.z, nominal.starts(), nominal.poses(), each)
    if again is None:
        raise AssertionError("a fit that starts at the optimum of another fit must be simulable")
    return NominalAnalysis(inverse, again, analysis.sensitivities, begun)


@dataclass(frozen=True, eq=False)
class SecondReading:
    """A request to estimate the noise again at the points predicted by the best single effect."""

    singles: Sequence[JointFit]
    best: JointFit


Wanted = Sequence[Combination] | SecondReading
Answer = Sequence[JointFit | None] | NominalAnalysis
Course = Generator[Wanted, Answer, "Diagnosis"]
"""Generator that yields requests and returns the diagnosis.

It yields combinations to be fitted and receives the fits in the same order, None for a combination
that could not be simulated; or it yields a second reading and receives the new analysis, which
applies to all later fits.
"""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and everything on which it is based.

    Parameters
    ----------
    analysis : NominalAnalysis
    verdict : Verdict
    joint_fits : dict of tuple of str to JointFit
        Joint fits by the names of their effects, in the order requested.
    hypotheses : tuple of Hypothesis
    """

    analysis: NominalAnalysis
    verdict: Verdict
    joint_fits: dict[tuple[str, ...], JointFit]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def best(self) -> JointFit | None:
        """The joint fit of the named effects."""
        named = set(self.verdict.primary)
        for names, fitted in self.joint_fits.items():
            if set(names) == named:
                return fitted
        return None


def diagnose(analysis: NominalAnalysis, effects: Sequence[Effect]) -> Course:
    """Request fits of the suspects and weigh them against each other.

    Parameters
    ----------
    analysis : NominalAnalysis
    effects : sequence of Effect
        The catalogue.
    """
    known = {e.name: e for e in effects}
    joint_fits = yield from _fitted([(e,) for e in suspects(analysis, known)])
    singles = ranked(joint_fits.values())
    if singles and is_elsewhere(analysis, singles[0].fit):
        analysis = _read((yield SecondReading(singles, singles[0])))
        joint_fits = yield from _fitted([single.effects for single in near_best(singles)])
    joint_fits |= yield from _fitted(pairs(analysis, known, list(joint_fits.values())))
    joint_fits |= yield from _fitted(triples(analysis, known, list(joint_fits.values())))
    reached, hypotheses = _weighed_up(analysis, known, joint_fits)
    if reached.kind == "none-of-these":
        joint_fits |= yield from _of_all(analysis, known, joint_fits)
        reached, hypotheses = _weighed_up(analysis, known, joint_fits)
    tried: set[tuple[str, ...]] = set()
    while missing := [names for names in unfitted(reached, joint_fits) if names not in tried]:
        tried |= set(missing)
        joint_fits |= yield from _fitted([tuple(known[n] for n in names) for names in missing])
        reached, hypotheses = _weighed_up(analysis, known, joint_fits)
    return Diagnosis(analysis, reached, joint_fits, hypotheses)


def _of_all(
    analysis: NominalAnalysis, known: dict[str, Effect], joint_fits: dict[tuple[str, ...], JointFit]
) -> Generator[Wanted, Answer, dict[tuple[str, ...], JointFit]]:
    """Request fits of all other visible effects, and of the resulting new combinations.

    A strong effect may change the constants so much that the linear model does not show it.
    """
    visible = [result.name for result in analysis.screening if not result.hides]
    new_fits = yield from _fitted([(known[n],) for n in visible if (n,) not in joint_fits])
    for combined in (pairs, triples):
        fits = joint_fits | new_fits
        tried = {frozenset(names) for names in fits}
        wanted = combined(analysis, known, list(fits.values()))
        new_fits |= yield from _fitted([w for w in wanted if {e.name for e in w} not in tried])
    return new_fits


def _weighed_up(
    analysis: NominalAnalysis, known: dict[str, Effect], joint_fits: dict[tuple[str, ...], JointFit]
) -> tuple[Verdict, tuple[Hypothesis, ...]]:
    """Return the verdict and the weighed hypotheses."""
    hypotheses = weigh(analysis, joint_fits)
    families = {one.name: known[one.name].family for one in analysis.sensitivities}
    odds = PriorOdds(of_effect={one.name: known[one.name].odds for one in analysis.sensitivities})
    return verdict(hypotheses, families, analysis.hidden, odds), hypotheses


def unfitted(reached: Verdict, joint_fits: Collection[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the effects on which a verdict depends, but which were not fitted."""
    fitted = {name for names in joint_fits for name in names}
    found: list[tuple[str, ...]] = [(name,) for name in sorted(set(reached.primary) - fitted)]
    doubt = 1.0 - SETTINGS.verdict.credible
    likely = [name for name in reached.hidden if reached.probabilities[name] > doubt]
    alone = [names for names in joint_fits if len(names) == 1 and names[0] not in reached.hidden]
    best = sorted(alone, key=lambda names: -reached.hypotheses[names, False])[:1]
    found += [(*names, hidden) for hidden in likely for names in [(), *best]]
    return [names for names in found if names not in joint_fits]


def advance(course: Course, answer: Answer | None = None) -> Wanted | Diagnosis:
    """Advance a diagnosis to its next request or to its end.

    Parameters
    ----------
    course : generator
        See `diagnose`.
    answer : sequence of JointFit or None, or NominalAnalysis, optional
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


def weigh(
    analysis: NominalAnalysis, joint_fits: dict[tuple[str, ...], JointFit]
) -> tuple[Hypothesis, ...]:
    """Return the evidence for every hypothesis, from its joint fit or else from the linear model.

    For joint fits, it includes the form error; see `workers.diagnosis.fits.model_errors`. It is
    coarsened; see `workers.diagnosis.noise.averaged_evidence`.
    """
    nominal = analysis.hypothesis(analysis.nominal)
    joint = JointEvidence(nominal, analysis.sensitivities, analysis.noise)
    alone = ((one.name,) for one in analysis.sensitivities)
    weighed = [joint.hypothesis(())]
    weighed += [joint.hypothesis(effects) for effects in alone if effects not in joint_fits]
    weighed += [_weighed(analysis, names, fitted) for names, fitted in joint_fits.items()]
    return tuple(one.coarsened(analysis.inverse.coarsening) for one in weighed)


def _weighed(analysis: NominalAnalysis, names: tuple[str, ...], fitted: JointFit) -> Hypothesis:
    at = analysis.hypothesis(fitted.fit)
    errors, sizes = analysis.errors_of_form(at), SETTINGS.form.relative_sds
    without, beside = analysis.noise.log_evidences_with_errors(at, errors, sizes)
    alone, acting = acting_or_alike(without)
    if beside is None:
        return Hypothesis(names, alone, acting=acting)
    together, acting_beside = acting_or_alike(beside)
    return Hypothesis(names, alone, together - alone, acting, acting_beside)


def _fitted(
    combinations: Sequence[Combination],
) -> Generator[Wanted, Answer, dict[tuple[str, ...], JointFit]]:
    """Request fits of combinations and return them by the names of their effects."""
    answer = (yield combinations) if combinations else []
    if isinstance(answer, NominalAnalysis):
        raise TypeError("expected joint fits, got an analysis")
    return {one.names: one for one in answer if one is not None}


def _read(answer: Answer) -> NominalAnalysis:
    if not isinstance(answer, NominalAnalysis):
        raise TypeError("expected an analysis, got joint fits")
    return answer
