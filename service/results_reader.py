"""Reads what a study has found so far from its journal.

Nothing is computed anew, and the study may be running meanwhile.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from service.identification import (
    Identification,
    identification_from_scatter,
    identification_from_tangents,
)
from service.local_model import SearchedConstants
from service.results import (
    CandidateResults,
    EvaluationCounts,
    GenerationResult,
    GenerationScores,
    ParameterEstimate,
    StageTime,
    StudyResults,
    StudyState,
)
from service.search.base import Generation
from service.search_replay import (
    PendingGeneration,
    SearchReplay,
    best_of,
    best_searched,
    equally_good,
)
from service.spec import StudySpec
from service.steady_replay import replayed
from service.study_log import StudyLog, read_study
from storage.errors import InputError
from storage.journal import Journal
from storage.layout import StudyLayout
from storage.plain import loads
from storage.records import EvaluationRecord
from workers.spec import validated


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
        estimates=estimates_of(spec, best, _before_polish(spec, log)),
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
    if spec.search.steady:
        return replayed(spec.steady_search, log.endings)
    return SearchReplay(spec.search_strategy, spec.search.space).replay(log.endings)


def _before_polish(spec: StudySpec, log: StudyLog) -> EvaluationRecord | None:
    """Return the best candidate of the genetic part, where there is another part."""
    polished = spec.search.strategy == "genetic+least-squares"
    return best_searched(log.endings) if polished else None


def estimates_of(
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
    alike, here = (
        [spec.constants_of(spec.case.canonical(record.genes)) for record in records]
        for records in (equally_good(log.endings, best), [best])
    )
    return identification_from_scatter(searched, best.candidate, here[0], alike, note)


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
