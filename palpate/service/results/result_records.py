"""Current results of a study: one schema for status, report and page, and what may be quoted.

`service.results.results_from_journal` creates it from a study's folder,
`service.results.results_as_json` writes it. The facts about the estimates are judged by
`service.results.quotability_rule`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from markupsafe import Markup

from palpate.service.number_formatting import (
    Quantity,
    bare,
    listed,
    not_neutral,
    number,
    quantities_inside,
    symbol,
)
from palpate.service.results.identification import (
    DEPENDENT,
    WEAK_PART,
    Identification,
    IdentifiedConstant,
    IdentifiedRatio,
    Interval,
    RatioEstimate,
    ratio_estimates,
)
from palpate.service.results.intervals import Posterior
from palpate.service.results.physical_limits import Bounds, at_bound, at_limit
from palpate.service.results.quotability_rule import (
    MOST_RESIDUAL,
    EstimateFacts,
    IdentifiedAs,
    Quotability,
    quotability,
)
from palpate.service.study.study_keys import StudySpec
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.read_only import ReadOnly
from palpate.storage.values import BodyFacts, Scores, TargetKind
from palpate.workers.common_keys import Identifiable
from palpate.workers.mechanics.fem.boundary_value_problem import SQUEEZED_J

UNDEFORMED = "the undeformed body"


def study_quotability(results: "StudyResults") -> dict[str, Quotability]:
    """Return the quotability of each searched parameter, by internal name."""
    return {
        name: one.quotability or quotability(facts_of(results, name))
        for name, one in results.estimates.items()
    }


def facts_of(results: "StudyResults", name: str) -> EstimateFacts:
    """Return the facts about one searched parameter."""
    estimate, known = results.estimates[name], results.identification
    constant = None if known is None else known.constants.get(name)
    return EstimateFacts(
        value=estimate.estimate,
        unit=estimate.unit,
        searched=(estimate.lower, estimate.upper),
        limit=estimate.limit,
        interval=None if constant is None else interval_ends(constant.interval),
        identifiable="unknown" if constant is None else constant.identifiable,
        finished=results.state == "stopped",
        converged=_converged(results),
        no_better_than=_no_better_than(results),
        residual_factor=1.0 if known is None else known.noise_factor,
        prior=_prior(results, name),
        prior_share=0.0 if constant is None else constant.prior_share,
        contradictions=(
            *_dependent(constant, results),
            *_of_all(results),
            *results.findings.get("against", {}).get(name, ()),
        ),
    )


def _prior(results: "StudyResults", name: str) -> Bounds | None:
    prior = results.spec.search.prior.get(results.estimates[name].gene)
    return None if prior is None else (prior.mean, prior.sd)


@dataclass(frozen=True)
class DerivedEstimate:
    """A value derived from the constants, with its 90 % interval.

    Parameters
    ----------
    name : str
    value : float
    unit : str
    interval : (float, float) or None
        None if it is withheld.
    answer : Quotability
    """

    name: str
    value: float
    unit: str
    interval: Bounds | None
    answer: Quotability


def derived_estimates(results: "StudyResults") -> list[DerivedEstimate]:
    """Return the values that an organ derives from the constants, such as G0 of a cornea."""
    return [_derived(results, one) for one in results.findings.get("derived", ())]


def with_intervals(results: "StudyResults") -> Mapping[str, Any]:
    """Return the findings with the intervals of derived values; None if withheld."""
    intervals = {one.name: one.interval for one in derived_estimates(results)}
    derived = results.findings.get("derived", ())
    found = [one | {"interval": intervals[one["name"]]} for one in derived]
    return {**results.findings, "derived": found} if found else results.findings


def _derived(results: "StudyResults", found: Mapping[str, Any]) -> DerivedEstimate:
    value, known = found["value"], results.identification
    factors = None if known is None else known.derived.get(found["name"])
    interval = None if factors is None else (value * factors.lower, value * factors.upper)
    answer = quotability(
        EstimateFacts(
            value=value,
            unit=found["unit"],
            interval=interval,
            identifiable=_how_known(value, interval),
            finished=results.state == "stopped",
            converged=_converged(results),
            no_better_than=_no_better_than(results),
            residual_factor=1.0 if known is None else known.noise_factor,
            contradictions=(*_bounded(results, found), *_of_all(results), *found["against"]),
        )
    )
    explained = known is not None and known.noise_factor <= MOST_RESIDUAL
    shown = interval if answer.interval_holds and explained else None
    return DerivedEstimate(found["name"], value, found["unit"], shown, answer)


def _bounded(results: "StudyResults", found: Mapping[str, Any]) -> list[str]:
    """Return a clause for each constant at a bound that affects a derived value."""
    estimates = results.estimates
    names = [
        n for n, by in found.get("slope", {}).items() if n in estimates and abs(by) > DEPENDENT
    ]
    return [
        f"it depends on {name}, which is at a bound of its searched interval"
        for name in names
        if estimates[name].at_bound
    ]


def _how_known(value: float, interval: Bounds | None) -> IdentifiedAs:
    if interval is None:
        return "unknown"
    return "weak" if interval[1] - interval[0] > WEAK_PART * abs(value) else "value"


def ratio_quotability(results: "StudyResults", ratio: IdentifiedRatio) -> Quotability:
    """Return the quotability of the ratio of two constants."""
    known = results.identification
    estimates = [results.estimates.get(n) for n in (ratio.numerator, ratio.denominator)]
    return quotability(
        EstimateFacts(
            value=ratio.estimate,
            interval=interval_ends(ratio.interval),
            identifiable=ratio.identifiable,
            finished=results.state == "stopped",
            converged=_converged(results),
            no_better_than=_no_better_than(results),
            residual_factor=1.0 if known is None else known.noise_factor,
            contradictions=(*_at_bounds(estimates), *_of_all(results)),
        )
    )


def ratio_answer(
    results: "StudyResults", ratio: RatioEstimate
) -> tuple[tuple[float, float] | None, Quotability]:
    """Return the interval of a ratio, or None if withheld, and its quotability."""
    known = results.identification
    ratios = {(r.numerator, r.denominator): r for r in (known.ratios if known is not None else ())}
    identified = ratios.get((ratio.numerator, ratio.denominator))
    if identified is None:
        identified = IdentifiedRatio(
            ratio.numerator, ratio.denominator, ratio.estimate or float("nan"), None, "unknown"
        )
    answer = ratio_quotability(results, identified)
    return (interval_ends(identified.interval) if answer.interval_holds else None), answer


def interval_ends(interval: Interval | None) -> tuple[float, float] | None:
    """Return the ends of an interval."""
    return None if interval is None else (interval.lower, interval.upper)


def no_better(
    before: Mapping[str, Scores], after: Mapping[str, Scores], parts: Iterable[str]
) -> bool:
    """Return True if the best candidate matches the target no better than the undeformed body."""
    compared = [part for part in parts if part in before and part in after]
    if not compared:
        return False
    return sum(after[p]["gsf"] for p in compared) >= sum(before[p]["gsf"] for p in compared)


def _no_better_than(results: "StudyResults") -> str:
    parts = results.spec.score.parts
    worse = no_better(results.undeformed_scores, results.best_scores, parts)
    return UNDEFORMED if worse else ""


def _converged(results: "StudyResults") -> bool:
    known = results.identification
    stopped_early = "has not converged" in (results.stop_reason or "")
    return not stopped_early and (known is None or known.converged)


def _dependent(constant: IdentifiedConstant | None, results: "StudyResults") -> list[str]:
    names = () if constant is None else constant.depends_on
    return [f"it depends on {name}, which is at a bound of its searched interval" for name in names]


def _at_bounds(estimates: Iterable["ParameterEstimate | None"]) -> list[str]:
    reasons = []
    for estimate in estimates:
        if estimate is not None:
            facts = EstimateFacts(
                value=estimate.estimate,
                unit=estimate.unit,
                searched=(estimate.lower, estimate.upper),
                limit=estimate.limit,
            )
            reasons += [
                f"{estimate.gene} is {reason}"
                for reason in quotability(facts).reasons
                if "bound" in reason
            ]
    return reasons


def _of_all(results: "StudyResults") -> tuple[str, ...]:
    """Return the objections to every estimate, as clauses."""
    return (*_supported(results), *([results.squeezed] if results.squeezed else []))


def _supported(results: "StudyResults") -> list[str]:
    known = results.identification
    if known is None or not known.supported:
        return []
    first, *others = known.supported
    beside = f", or in {listed(others, 'or')}" if others else ""
    return [f"the residual points to an error in {first}{beside}"]


StudyState = Literal["running", "stopped", "interrupted"]


@dataclass(frozen=True)
class ParameterEstimate:
    """The estimate of one searched parameter, with its interval and whether it may be quoted.

    Parameters
    ----------
    gene : str
        Its name in the study file, which may end in the unit.
    unit : str
        Unit of all values, such as kPa; empty for a pure number.
    lower, upper : float
        Bounds of the search.
    estimate : float or None
        Value of the best candidate; None if no candidate has a score, or the best one is no
        better than the undeformed body.
    target : float or None
        The value used to simulate the target; None for an image.
    before_polish : float or None
        Value of the best candidate before the refinement by derivatives; None if the study
        has no such stage.
    interval : (float, float) or None
        90 % interval; None if it is unknown or withheld.
    quotability : Quotability or None
        Whether the estimate may be quoted; None until this is decided.
    limit : float or None
        Physical limit, below which there are no values.
    description : str
        Such as ``fibre stiffness of fat and ligaments``; may be empty.
    """

    gene: str
    unit: str
    lower: float
    upper: float
    estimate: float | None
    target: float | None
    before_polish: float | None = None
    interval: tuple[float, float] | None = None
    quotability: Quotability | None = None
    limit: float | None = None
    description: str = ""

    @property
    def at_bound(self) -> bool:
        """Return True if the estimate is at a bound of the search that is not its limit."""
        searched = self.lower, self.upper
        return self.estimate is not None and at_bound(self.estimate, searched, self.limit)

    @property
    def one_sided(self) -> bool:
        """Return True if the estimate rests at its limit, where its interval begins."""
        if self.estimate is None or self.interval is None or self.limit is None:
            return False
        rests = at_limit(self.estimate, (self.lower, self.upper), self.limit)
        return rests and self.interval[0] <= self.limit

    @property
    def limit_note(self) -> str:
        """Return that nothing above the limit is needed, as a clause; empty if not one-sided."""
        if not self.one_sided:
            return ""
        what = self.description or bare(self.gene, self.unit)
        if not self.limit:
            return f"no {what} is needed"
        return f"no {what} above {number(self.limit)} {self.unit}".rstrip() + " is needed"

    @property
    def interval_text(self) -> str:
        """Return the interval as ``9.1 to 11``, ``below 12`` if one-sided; empty if unknown."""
        if self.interval is None:
            return ""
        if self.one_sided:
            return f"below {number(self.interval[1])}"
        return " to ".join(map(number, self.interval))

    @property
    def text(self) -> str:
        """Return the estimate as ``10 (9.1 to 11) kPa``, or ``< 12 kPa (90 %)``."""
        if self.one_sided and self.interval is not None:
            return f"< {number(self.interval[1])} {self.unit}".rstrip() + " (90 %)"
        between = f" ({self.interval_text})" if self.interval else ""
        return f"{number(self.estimate)}{between} {self.unit}".rstrip()

    @property
    def quotable(self) -> bool:
        """Return True if the estimate may be quoted."""
        return self.quotability is not None and self.quotability.quotable

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the reasons against quoting the estimate, as clauses; empty if there are none."""
        return () if self.quotability is None else self.quotability.reasons

    @property
    def relative_error(self) -> float | None:
        """Return ``|estimate - target| / target``; None if either is unknown."""
        if self.estimate is None or not self.target:
            return None
        return abs(self.estimate - self.target) / self.target

    def __str__(self) -> str:
        if self.estimate is None:
            return f"{self.gene} not estimated"
        return f"{bare(self.gene, self.unit)} {self.text}"

    def __repr__(self) -> str:
        answer = "" if self.quotability is None else f"; {self.quotability.sentence}"
        return f"<Estimate {self}{answer}"[:498] + ">"

    def _repr_html_(self) -> str:
        name = symbol(self.gene, self.unit)
        value = f" {self.text}"
        answer = "" if self.quotability is None else f". {self.quotability.sentence}."
        return str(Markup("{}{}{}").format(name, value, answer))


@dataclass(frozen=True)
class EvaluationCounts:
    """Numbers of evaluations by ending, and the number of those already in the store."""

    done: int
    diverged: int
    crashed: int
    lost: int
    reused: int


@dataclass(frozen=True)
class GenerationScores(ReadOnly):
    """The scores of a complete generation.

    Parameters
    ----------
    best : float
        Score of the best candidate; -inf for identical volumes, +inf if all have failed.
    mean : float or None
        Mean of the finite scores; None if there are none.
    best_candidate : int
        Number of the best candidate: by the sum of squares if that is minimised, else by score.
    best_genes : mapping of str to float
        Its parameters, in external units.
    failed : int
        Number of candidates without a score.
    """

    best: float
    mean: float | None
    best_candidate: int
    best_genes: Mapping[str, float]
    failed: int


@dataclass(frozen=True)
class GenerationResult:
    """One generation of the search.

    Parameters
    ----------
    number : int
        From 0.
    evaluations : int
        Number of candidates that need an evaluation; elites need none.
    ended : int
        Number of evaluations that have ended.
    scores : GenerationScores or None
        None until all candidates have an ending.
    """

    number: int
    evaluations: int
    ended: int
    scores: GenerationScores | None


@dataclass(frozen=True)
class StageTime:
    """Time spent in one stage by the computed evaluations, in seconds."""

    total_s: float
    mean_s: float
    count: int


@dataclass(frozen=True)
class StudyResults(ReadOnly):
    """All results shown by a status or a report.

    Parameters
    ----------
    folder : Path
        Folder of the study.
    spec : StudySpec
        The study file with all defaults.
    state : {"running", "stopped", "interrupted"}
    stop_reason : str or None
        Why the search has stopped; None if it has not.
    estimates : mapping of str to ParameterEstimate
        By internal name, such as ``E_fat``.
    best : EvaluationRecord or None
        The best candidate, as `storage.best_candidate` ranks them; None if none has a score.
    counts : EvaluationCounts
    generations : tuple of GenerationResult
    failures : tuple of EvaluationRecord
        Evaluations without a score, in the order of the candidates.
    undeformed_scores, best_scores : mapping of str to Scores
        By tissue, of the undeformed body and of the best candidate; empty until the search has
        stopped.
    wall_s : float
        Wall time of all runs, including preparation.
    stages : mapping of str to StageTime
        By stage, over the evaluations computed by this study.
    body_facts : BodyFacts
        Facts about body and mesh; empty until they are prepared.
    target_kind : {"simulated", "image"} or None
        None until the target is prepared.
    sessions : int
        Number of runs.
    versions : mapping of str to str
        Versions of Palpate, its code and the packages on which results depend.
    store : str or None
        Store of the last run.
    findings : mapping
        Findings about the fitted body, may be empty; see `workers.organs.organ_plugins.Findings`.
    identification : Identification or None
        The identifiability of each constant; None until the search has stopped.
    unverified_records : int
        Number of journal records without a checksum, written by an earlier version.
    unchained_records : int
        Number of journal records that do not name the one before, written by an earlier version.
    lowest_score : EvaluationRecord or None
        The candidate with the lowest score, if it is not the best one.
    best_note : str
        Why the best candidate does not have the lowest score; empty if it does.
    posterior : Posterior or None
        The posterior behind the intervals; None without derivatives of the best candidate.
    """

    folder: Path
    spec: StudySpec
    state: StudyState
    stop_reason: str | None
    estimates: Mapping[str, ParameterEstimate]
    best: EvaluationRecord | None
    counts: EvaluationCounts
    generations: tuple[GenerationResult, ...]
    failures: tuple[EvaluationRecord, ...]
    undeformed_scores: Mapping[str, Scores]
    best_scores: Mapping[str, Scores]
    wall_s: float
    stages: Mapping[str, StageTime]
    body_facts: BodyFacts
    target_kind: TargetKind | None
    sessions: int
    versions: Mapping[str, str]
    store: str | None
    findings: Mapping[str, Any] = field(default_factory=dict)
    identification: Identification | None = None
    unverified_records: int = 0
    unchained_records: int = 0
    caveats: tuple[str, ...] = ()
    lowest_score: EvaluationRecord | None = None
    best_note: str = ""
    posterior: Posterior | None = None

    def __repr__(self) -> str:
        found = ", ".join(map(str, list(self.estimates.values())[:4]))
        more = ", ..." if len(self.estimates) > 4 else ""
        return f"<Results of {self.name}, {self.state}: {found}{more}"[:498] + ">"

    @property
    def name(self) -> str:
        """Return the name of the study."""
        return self.spec.name

    @property
    def squeezed(self) -> str:
        """Return a clause if the best simulation has a collapsed element; empty otherwise."""
        if self.best is None or not (self.best.outcome or {}).get("squeezed"):
            return ""
        return f"its simulation squeezes an element to less than {SQUEEZED_J:g} of its volume"

    @property
    def squeezed_note(self) -> str:
        """Return `squeezed` as a sentence; empty if no element has collapsed."""
        return self.squeezed and f"Do not trust the best candidate: {self.squeezed}."

    @property
    def identifiable(self) -> Identifiable:
        """Return the identifiability of the stiffnesses: values, or only their ratios."""
        return self.spec.identifiable

    @property
    def ratios(self) -> tuple[RatioEstimate, ...]:
        """Return the ratios of stiffnesses if only these can be found."""
        return ratio_estimates(self.estimates) if self.identifiable == "ratio" else ()

    @property
    def quotability(self) -> dict[str, Quotability]:
        """Return the quotability of each estimate, by internal name."""
        return study_quotability(self)

    @property
    def judged(self) -> "StudyResults":
        """Return the results with intervals and quotability; invalid intervals are withheld."""
        answers, known = self.quotability, self.identification
        constants = {} if known is None else dict(known.constants)
        for name in constants.keys() & answers.keys():
            if not answers[name].interval_holds:
                constants[name] = replace(constants[name], interval=None)
        estimates = {
            name: replace(
                estimate,
                estimate=estimate.estimate if answers[name].estimated else None,
                interval=interval_ends(constants[name].interval) if name in constants else None,
                quotability=answers[name],
            )
            for name, estimate in self.estimates.items()
        }
        shown = None if known is None else replace(known, constants=constants)
        return replace(self, estimates=estimates, identification=shown)

    @property
    def best_score(self) -> Scores | None:
        """Return the scores of the best candidate over all compared tissues."""
        return None if self.best is None else self.best.score

    @property
    def complete_generations(self) -> list[tuple[GenerationResult, GenerationScores]]:
        """Return the generations whose scores are all known, with their scores."""
        return [(g, g.scores) for g in self.generations if g.scores is not None]


@dataclass(frozen=True)
class CandidateResults(ReadOnly):
    """All results of one candidate.

    Parameters
    ----------
    spec : StudySpec
        The study file.
    candidate, generation : int
        Candidate and generation numbers from 0.
    evaluated_as : int
        The candidate whose evaluation it shares: an elite has the ending of the candidate
        from which it was carried over.
    genes : mapping of str to float
        In external units.
    evaluation : EvaluationRecord or None
        Its ending; None before it has ended.
    """

    spec: StudySpec
    candidate: int
    generation: int
    evaluated_as: int
    genes: Mapping[str, float]
    evaluation: EvaluationRecord | None

    def held(self, *, everything: bool) -> dict[str, Quantity]:
        """Return the constants of its simulation that are not searched.

        Parameters
        ----------
        everything : bool
            Whether to include constants at their neutral values.
        """
        case = self.spec.case
        vocabulary = case.vocabulary
        searched = self.spec.constants_of(self.genes)
        constants = case.complete(searched)
        stated = case.parameters.from_door(case.constants)
        kept = constants if everything else not_neutral(vocabulary, constants, stated)
        held = {name: value for name, value in kept.items() if name not in searched}
        return quantities_inside(vocabulary, held)
