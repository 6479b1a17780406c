"""Writes results as the JSON records that `--json` prints.

Their keys are a promise to scripts that read them. Scores that are infinite are the texts
"-inf" and "inf".
"""

from dataclasses import asdict
from typing import Any

from service.identification import Identification
from service.results import (
    CandidateResults,
    GenerationResult,
    ParameterEstimate,
    StageTime,
    StudyResults,
)
from storage.plain import to_plain
from storage.records import EvaluationRecord
from storage.status import Status
from storage.task_records import Scores


def study_json(results: StudyResults) -> dict[str, Any]:
    """Return the record that `palpate status --json`, `report --json` and `run --json` print."""
    record = {
        "study": results.name,
        "state": results.state,
        "stopped": results.stop_reason,
        "estimates": {name: _estimate(e) for name, e in results.estimates.items()},
        "identification": _identification(results.identification),
        "score": _score(results.best_score or {}),
        "best": None if results.best is None else _evaluation(results.best),
        "evaluations": asdict(results.counts),
        "generations": [_generation(g) for g in results.generations],
        "failures": [_evaluation(record) for record in results.failures],
        "per_label_before": results.undeformed_scores,
        "per_label": results.best_scores,
        "seconds": results.wall_s,
        "stages": {stage: _stage(time) for stage, time in results.stages.items()},
        "facts": results.body_facts,
        "target_kind": results.target_kind,
        "sessions": results.sessions,
        "versions": results.versions,
        "store": results.store,
        "folder": str(results.folder),
        "config": results.spec.as_dict(),
    }
    return dict(to_plain(record))


def candidate_json(results: CandidateResults) -> dict[str, Any]:
    """Return the record that `palpate show --json` prints."""
    record: dict[str, Any] = {
        "study": results.study,
        "candidate": results.candidate,
        "generation": results.generation,
        "evaluated_as": results.evaluated_as,
        "genes": results.genes,
    }
    ending = results.evaluation
    if ending is None:
        return dict(to_plain(record | {"status": Status.WAITING}))
    return dict(
        to_plain(
            record
            | {
                "status": ending.status,
                "score": ending.score,
                "reason": ending.reason,
                "traceback": ending.traceback,
                "outcome": ending.outcome,
                "seconds": ending.seconds,
                "worker": ending.worker,
                "attempts": ending.attempts,
                "reused": ending.reused,
                "digest": ending.digest,
            }
        )
    )


def _estimate(estimate: ParameterEstimate) -> dict[str, Any]:
    return {
        "gene": estimate.gene,
        "estimate": estimate.estimate,
        "target": estimate.target,
        "relative_error": estimate.relative_error,
        "unit": estimate.unit,
        "bounds": [estimate.lower, estimate.upper],
    }


def _identification(found: Identification | None) -> dict[str, Any] | None:
    return None if found is None else asdict(found) | {"weak": list(found.weak)}


def _score(score: Scores) -> dict[str, float | None]:
    return {
        "jc": score.get("jc"),
        "mhd_mm": score.get("mhd_mm"),
        "mhd_voxels": score.get("mhd_voxels"),
        "gsf": score.get("gsf"),
    }


def _evaluation(record: EvaluationRecord) -> dict[str, Any]:
    return {
        "candidate": record.candidate,
        "generation": record.generation,
        "status": record.status,
        "reason": record.reason,
        "genes": record.genes,
        "score": record.score,
        "digest": record.digest,
    }


def _generation(generation: GenerationResult) -> dict[str, Any]:
    record: dict[str, Any] = {
        "number": generation.number,
        "asked": generation.evaluations,
        "ended": generation.ended,
        "complete": generation.scores is not None,
    }
    return record if generation.scores is None else record | asdict(generation.scores)


def _stage(time: StageTime) -> dict[str, float]:
    return {"total": time.total_s, "mean": time.mean_s, "count": time.count}
