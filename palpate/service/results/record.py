"""Current results of a study: one schema for status, report and page.

`service.results.read` creates it from a study's folder, `service.results.as_json` writes it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from markupsafe import Markup

from palpate.service.formatting import bare, number, symbol
from palpate.service.quantities import Quantity, not_neutral, quantities_inside
from palpate.service.results.identification import Identification
from palpate.service.results.posterior import Posterior
from palpate.service.results.quotability import ends, study_quotability
from palpate.service.results.quotable import Quotability
from palpate.service.results.ratios import RatioEstimate, ratio_estimates
from palpate.service.study.spec import StudySpec
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.tasks import BodyFacts, Scores, TargetKind
from palpate.workers.mechanics.fem.problem.outcome import SQUEEZED_J
from palpate.workers.spec import Identifiable

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
        between = "" if self.interval is None else f" ({' to '.join(map(number, self.interval))})"
        return f"{bare(self.gene, self.unit)} {number(self.estimate)}{between} {self.unit}".rstrip()

    def __repr__(self) -> str:
        answer = "" if self.quotability is None else f"; {self.quotability.sentence}"
        return f"<Estimate {self}{answer}"[:498] + ">"

    def _repr_html_(self) -> str:
        name = symbol(self.gene, self.unit)
        between = "" if self.interval is None else f" ({' to '.join(map(number, self.interval))})"
        value = f" {number(self.estimate)}{between} {self.unit}".rstrip()
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
class GenerationScores:
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
class StudyResults:
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
        The best candidate, as `records.best_candidate` ranks them; None if none has a score.
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
        Findings about the fitted body, may be empty; see `workers.organs.registry.Findings`.
    identification : Identification or None
        The identifiability of each constant; None until the search has stopped.
    unverified_records : int
        Number of journal records without a checksum, written by an earlier version.
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
                one,
                estimate=one.estimate if answers[name].estimated else None,
                interval=ends(constants[name].interval) if name in constants else None,
                quotability=answers[name],
            )
            for name, one in self.estimates.items()
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
class CandidateResults:
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
