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
"""

from collections.abc import Collection, Generator, Sequence
from dataclasses import dataclass

from palpate.workers.diagnosis.screening.form_error import acting_or_alike
from palpate.workers.diagnosis.screening.nominal_analysis import NominalAnalysis
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.hypotheses import Hypothesis, PriorOdds
from palpate.workers.diagnosis.verdict.joint_evidence import JointEvidence
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.diagnosis.verdict.second_reading import is_elsewhere
from palpate.workers.diagnosis.verdict.suspects import (
    Combination,
    near_best,
    pairs,
    ranked,
    suspects,
    triples,
)
from palpate.workers.diagnosis.verdict.verdict import Verdict, verdict
from palpate.workers.mechanics.effects.base import Effect


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
        joint_fits = yield from _fitted([one.effects for one in near_best(singles)])
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
    visible = [one.name for one in analysis.screening if not one.hides]
    found = yield from _fitted([(known[n],) for n in visible if (n,) not in joint_fits])
    for combined in (pairs, triples):
        fits = joint_fits | found
        tried = {frozenset(names) for names in fits}
        wanted = combined(analysis, known, list(fits.values()))
        found |= yield from _fitted([w for w in wanted if {e.name for e in w} not in tried])
    return found


def _weighed_up(
    analysis: NominalAnalysis,
    known: dict[str, Effect],
    joint_fits: dict[tuple[str, ...], JointFit],
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

    For joint fits, it includes the form error; see `workers.diagnosis.screening.form_error`. It is
    coarsened; see `workers.diagnosis.noise.evidence`.
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
