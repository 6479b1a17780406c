"""Reads what a study has found so far: one schema for status, report and page.

Everything comes from the study's journal; nothing is computed anew, and the study may be
running meanwhile. `service.results_json` writes the same as JSON.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from service.identification import (
    Identification,
    SearchedConstants,
    identification_from_scatter,
    identification_from_tangents,
)
from service.quantities import Quantity, not_neutral, quantities_inside
from service.ratios import RatioEstimate, ratio_estimates
from service.search.base import Generation
from service.search_replay import (
    PendingGeneration,
    SearchReplay,
    best_of,
    best_searched,
    equally_good,
)
from service.spec import StudySpec
from service.study_log import StudyLog, read_study
from storage.errors import InputError
from storage.journal import Journal
from storage.layout import StudyLayout
from storage.plain import loads
from storage.records import EvaluationRecord
from storage.task_records import BodyFacts, Scores, TargetKind
from workers.organs.registry import organ_named
from workers.spec import Identifiable, validated

StudyState = Literal["running", "stopped", "interrupted"]


@dataclass(frozen=True)
class ParameterEstimate:
    """One searched parameter, in its unit at the door.

    Parameters
    ----------
    gene : str
        Its name in the study file, which may end with the unit.
    unit : str
        Such as kPa; empty for a pure number.
    lower, upper : float
        Bounds of the search.
    estimate : float or None
        Of the best candidate; None if no candidate has a score.
    target : float or None
        What the target was simulated with; None if it comes from an image.
    before_polish : float or None
        Of the best candidate before the best were fitted by derivatives; None where that is
        not what the study does.
    """

    gene: str
    unit: str
    lower: float
    upper: float
    estimate: float | None
    target: float | None
    before_polish: float | None = None

    @property
    def relative_error(self) -> float | None:
        """Return ``|estimate - target| / target``; None where one of them is not known."""
        if self.estimate is None or not self.target:
            return None
        return abs(self.estimate - self.target) / self.target


@dataclass(frozen=True)
class EvaluationCounts:
    """How many evaluations ended in which way, and how many of them the store had already."""

    done: int
    diverged: int
    crashed: int
    lost: int
    reused: int


@dataclass(frozen=True)
class GenerationScores:
    """The scores of a generation that is complete.

    Parameters
    ----------
    best : float
        Lowest GSF; -inf for identical volumes, +inf if all have failed.
    mean : float or None
        Of the finite scores; None if there are none.
    best_candidate : int
        Number of the candidate with the lowest score.
    best_genes : mapping of str to float
        Its parameters, in their units at the door.
    failed : int
        Candidates without a score.
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
        Candidates that need an evaluation; elites need none.
    ended : int
        Evaluations that have ended.
    scores : GenerationScores or None
        None until all candidates have an ending.
    """

    number: int
    evaluations: int
    ended: int
    scores: GenerationScores | None


@dataclass(frozen=True)
class StageTime:
    """Seconds that the computed evaluations spent in one stage."""

    total_s: float
    mean_s: float
    count: int


@dataclass(frozen=True)
class StudyResults:
    """All that a status or a report says of a study.

    Parameters
    ----------
    folder : Path
        Of the study.
    spec : StudySpec
        The study file with all defaults.
    state : {"running", "stopped", "interrupted"}
    stop_reason : str or None
        Why the search has stopped; None if it has not.
    estimates : mapping of str to ParameterEstimate
        By the name of the parameter inside, such as ``E_fat``.
    best : EvaluationRecord or None
        The candidate with the lowest score; None if none has a score.
    counts : EvaluationCounts
    generations : tuple of GenerationResult
    failures : tuple of EvaluationRecord
        Evaluations without a score, in the order of the candidates.
    undeformed_scores, best_scores : mapping of str to Scores
        By tissue, of the undeformed body and of the best candidate; empty until the search has
        stopped.
    wall_s : float
        Of all runs, preparation included.
    stages : mapping of str to StageTime
        By stage, over the evaluations that this study has computed.
    body_facts : BodyFacts
        Of body and mesh; empty until they are prepared.
    target_kind : {"simulated", "image"} or None
        None until the target is prepared.
    sessions : int
        How often the study was run.
    versions : mapping of str to str
        Of Palpate, its code and the packages that results depend on.
    store : str or None
        Of the last run.
    findings : mapping
        What the fitted body tells; see `workers.organs.registry.Findings`. Maybe empty.
    identification : Identification or None
        How well the image determines each constant; None until the search has stopped.
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

    @property
    def name(self) -> str:
        """Return the name of the study."""
        return self.spec.name

    @property
    def identifiable(self) -> Identifiable:
        """Return whether the load tells the estimates or only their ratios."""
        return self.spec.identifiable

    @property
    def ratios(self) -> tuple[RatioEstimate, ...]:
        """Return the ratios of stiffnesses where these are all that can be found."""
        return ratio_estimates(self.estimates) if self.identifiable == "ratio" else ()

    @property
    def best_score(self) -> Scores | None:
        """Return the scores of the best candidate over all compared tissues together."""
        return None if self.best is None else self.best.score

    @property
    def complete_generations(self) -> list[tuple[GenerationResult, GenerationScores]]:
        """Return the generations whose scores are all known, with them."""
        return [(g, g.scores) for g in self.generations if g.scores is not None]


@dataclass(frozen=True)
class CandidateResults:
    """All that is known of one candidate.

    Parameters
    ----------
    spec : StudySpec
        Of the study.
    candidate, generation : int
        Generations from 0.
    evaluated_as : int
        The candidate whose evaluation it shares: an elite has the ending of the candidate that
        it was carried over from.
    genes : mapping of str to float
        In their units at the door.
    evaluation : EvaluationRecord or None
        Its ending; None while it has none.
    """

    spec: StudySpec
    candidate: int
    generation: int
    evaluated_as: int
    genes: Mapping[str, float]
    evaluation: EvaluationRecord | None

    def held(self, *, everything: bool) -> dict[str, Quantity]:
        """Return the constants that it was simulated with and that are not searched.

        Parameters
        ----------
        everything : bool
            Those at their neutral values as well.
        """
        case = self.spec.case
        vocabulary = organ_named(case.organ).parameters
        searched = self.spec.constants_of(self.genes)
        constants = case.complete(searched)
        stated = case.parameters.from_door(case.constants)
        kept = constants if everything else not_neutral(vocabulary, constants, stated)
        held = {name: value for name, value in kept.items() if name not in searched}
        return quantities_inside(vocabulary, held)


def study_results(folder: Path) -> StudyResults:
    """Read what a study has found so far.

    Raises
    ------
    InputError
        If `folder` is no study.
    JournalError
        If its journal is damaged.
    """
    study, log = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    best, session, end = best_of(log.endings), log.last_session, log.end
    endings = [record for _, record in sorted(log.endings.items())]
    return StudyResults(
        folder=folder.absolute(),
        spec=spec,
        state=_state(folder, log),
        stop_reason=None if end is None else end.reason,
        estimates=_estimates(spec, best, _before_polish(spec, log)),
        best=best,
        counts=_counts(endings),
        generations=tuple(_generations(spec, log)),
        failures=tuple(record for record in endings if record.reason),
        undeformed_scores={} if end is None else end.before,
        best_scores={} if end is None else end.per_label,
        wall_s=log.wall_s(_last_sign(folder)),
        stages=_stages(log.endings.values()),
        body_facts={} if session is None else session.prepared["facts"],
        target_kind=None if session is None else session.target["kind"],
        sessions=len(log.sessions),
        versions=study.versions if session is None else session.versions,
        store=None if session is None else session.store,
        findings=_findings(folder),
        identification=_identification(spec, log, best),
    )


def candidate_results(folder: Path, candidate: int | None) -> CandidateResults:
    """Read all that is known of one candidate; of the best one when None.

    Raises
    ------
    InputError
        If there is no such candidate.
    """
    study, log = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    if candidate is None:
        best = best_of(log.endings)
        if best is None:
            raise _no_such("best candidate", folder, "no candidate has a score yet")
        candidate = best.candidate
    generations = [pending for pending, _ in _replayed(spec, log)]
    by_candidate = {g.first + i: g for g in generations for i in range(len(g.proposal.genes))}
    if candidate not in by_candidate:
        count = f"its candidates are 0 to {len(by_candidate) - 1} so far"
        raise _no_such(f"candidate {candidate}", folder, count)
    generation = by_candidate[candidate]
    origin = candidate
    while (before := by_candidate[origin].carried_from(origin)) is not None:
        origin = before
    genes, ending = generation.genes(candidate), log.endings.get(origin)
    return CandidateResults(spec, candidate, generation.number, origin, genes, ending)


def is_running(folder: Path) -> bool:
    """Return whether a driver holds the journal of the study."""
    return Journal.is_being_written(StudyLayout(folder).journal)


def _no_such(what: str, folder: Path, why: str) -> InputError:
    return InputError(f"The study {folder} has no {what}: {why}.")


def _findings(folder: Path) -> Mapping[str, Any]:
    path = StudyLayout(folder).findings
    return dict(loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def _last_sign(folder: Path) -> datetime:
    """Return until when a study has run: until now, or until it last wrote its journal."""
    journal = StudyLayout(folder).journal
    written = datetime.fromtimestamp(journal.stat().st_mtime, UTC)
    return datetime.now(UTC) if is_running(folder) else written


def _state(folder: Path, log: StudyLog) -> StudyState:
    if is_running(folder):
        return "running"
    return "interrupted" if log.end is None else "stopped"


def _replayed(
    spec: StudySpec, log: StudyLog
) -> Iterable[tuple[PendingGeneration, Generation | None]]:
    return SearchReplay(spec.search_strategy, spec.search.space).replay(log.endings)


def _before_polish(spec: StudySpec, log: StudyLog) -> EvaluationRecord | None:
    """Return the best candidate of the genetic part, where there is another part."""
    polished = spec.search.strategy == "genetic+least-squares"
    return best_searched(log.endings) if polished else None


def _estimates(
    spec: StudySpec, best: EvaluationRecord | None, before: EvaluationRecord | None
) -> dict[str, ParameterEstimate]:
    parameters = spec.case.parameters
    target: dict[str, float] = {}
    if spec.target.constants is not None:
        constants = spec.case.complete(parameters.from_door(spec.target.constants))
        known = {name: value for name, value in constants.items() if name in parameters}
        target = spec.case.canonical(parameters.to_door(known) | dict(spec.target.constants))
    genes = None if best is None else spec.case.canonical(best.genes)
    estimates = {}
    for gene, (lower, upper) in spec.search.parameters.items():
        parameter = parameters.at_door(gene)
        estimate = None if genes is None else genes[gene]
        unpolished = None if before is None else spec.case.canonical(before.genes)[gene]
        estimates[parameter.name] = ParameterEstimate(
            gene, parameter.unit.symbol, lower, upper, estimate, target.get(gene), unpolished
        )
    return estimates


def _identification(
    spec: StudySpec, log: StudyLog, best: EvaluationRecord | None
) -> Identification | None:
    """Return what the image tells of the constants, once the search has stopped."""
    if best is None or log.end is None:
        return None
    searched = SearchedConstants(
        spec.case.parameters,
        spec.case.parameters.bounds_from_door(spec.search.parameters),
        spec.common_scale,
    )
    found = log.identification
    if found is not None and found.fit is not None:
        return identification_from_tangents(searched, found.candidate, found.fit)
    note = "the study ran before there were tangents" if found is None else found.reason
    alike = [spec.constants_of(record.genes) for record in equally_good(log.endings, best)]
    here = spec.constants_of(best.genes)
    return identification_from_scatter(searched, best.candidate, here, alike, note)


def _generations(spec: StudySpec, log: StudyLog) -> Iterable[GenerationResult]:
    for pending, generation in _replayed(spec, log):
        ended = sum(candidate in log.endings for candidate in pending.candidates)
        scores = None if generation is None else _scores(pending, generation)
        yield GenerationResult(pending.number, len(pending.candidates), ended, scores)


def _scores(pending: PendingGeneration, generation: Generation) -> GenerationScores:
    index = generation.best
    finite = generation.scores[np.isfinite(generation.scores)]
    return GenerationScores(
        best=float(generation.scores[index]),
        mean=float(finite.mean()) if len(finite) else None,
        best_candidate=pending.first + index,
        best_genes=pending.genes(pending.first + index),
        failed=int(np.isposinf(generation.scores).sum()),
    )


def _counts(endings: Iterable[EvaluationRecord]) -> EvaluationCounts:
    endings = list(endings)
    by_status = Counter(str(record.status) for record in endings)
    done, diverged, crashed, lost = (
        by_status[status] for status in ("done", "diverged", "crashed", "lost")
    )
    reused = sum(record.reused for record in endings)
    return EvaluationCounts(done, diverged, crashed, lost, reused)


def _stages(endings: Iterable[EvaluationRecord]) -> dict[str, StageTime]:
    """Add up the time of each stage over the evaluations that this study has computed."""
    seconds_by_stage: dict[str, list[float]] = {}
    for record in endings:
        if not record.reused:
            for stage, seconds in record.seconds.items():
                seconds_by_stage.setdefault(stage, []).append(seconds)
    return {
        stage: StageTime(sum(spent), sum(spent) / len(spent), len(spent))
        for stage, spent in seconds_by_stage.items()
    }
