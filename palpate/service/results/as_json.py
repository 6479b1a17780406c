"""The JSON records printed by `--json`.

Scripts depend on the keys. Infinite scores are the strings "-inf" and "inf". A parameter is
``{"value": 10.0, "unit": "kPa"}``. Generations are counted from 1, as on the console and on the
page.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from palpate.service.quantities import quantities_at_door, quantities_json
from palpate.service.results.identification import Identification
from palpate.service.results.quotability import DerivedEstimate, derived_estimates, ratio_answer
from palpate.service.results.ratios import RatioEstimate
from palpate.service.results.record import (
    CandidateResults,
    GenerationResult,
    ParameterEstimate,
    StageTime,
    StudyResults,
)
from palpate.service.study.spec import StudySpec
from palpate.storage.plain import to_plain
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.status import Status
from palpate.storage.records.tasks import Scores


def study_json(results: StudyResults) -> dict[str, Any]:
    """Return the record printed by `palpate status --json`, `report --json` and `run --json`."""
    spec = results.spec
    record = {
        "study": results.name,
        "caveats": list(results.caveats),
        "state": results.state,
        "stopped": results.stop_reason,
        "identifiable": results.identifiable,
        "ratios": {r.name: _ratio(r, results) for r in results.ratios},
        "estimates": {name: _estimate(e) for name, e in results.estimates.items()},
        "identification": _identification(results.identification),
        "score": _score(results.best_score or {}),
        "best": None if results.best is None else _evaluation(results.best, spec),
        "evaluations": asdict(results.counts),
        "generations": [_generation(g, spec) for g in results.generations],
        "failures": [_evaluation(record, spec) for record in results.failures],
        "per_label_before": results.undeformed_scores,
        "per_label": results.best_scores,
        "seconds": results.wall_s,
        "findings": results.findings,
        "derived": {one.name: _derived(one) for one in derived_estimates(results)},
        "stages": {stage: _stage(time) for stage, time in results.stages.items()},
        "facts": results.body_facts,
        "target_kind": results.target_kind,
        "sessions": results.sessions,
        "unverified_records": results.unverified_records,
        "versions": results.versions,
        "store": results.store,
        "folder": str(results.folder),
        "config": spec.as_dict(),
        "lowest_score": None if (low := results.lowest_score) is None else _evaluation(low, spec),
        "best_note": results.best_note,
    }
    return dict(to_plain(record))


def candidate_json(results: CandidateResults, *, everything: bool = False) -> dict[str, Any]:
    """Return the record printed by `palpate show --json`.

    Parameters
    ----------
    results : CandidateResults
    everything : bool
        Whether to include constants at their neutral values.
    """
    record: dict[str, Any] = {
        "study": results.spec.name,
        "candidate": results.candidate,
        "generation": results.generation + 1,
        "evaluated_as": results.evaluated_as,
        "genes": _genes(results.genes, results.spec),
        "held": quantities_json(results.held(everything=everything)),
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
    before = estimate.before_polish
    record = {} if before is None else {"before_polish": before}
    return record | {
        "gene": estimate.gene,
        "estimate": estimate.estimate,
        "target": estimate.target,
        "relative_error": estimate.relative_error,
        "unit": estimate.unit,
        "bounds": [estimate.lower, estimate.upper],
        "interval": _interval(estimate.interval),
        "quotable": estimate.quotable,
        "reasons": list(estimate.reasons),
    }


def _identification(found: Identification | None) -> dict[str, Any] | None:
    return None if found is None else asdict(found) | {"weak": list(found.weak)}


def _ratio(ratio: RatioEstimate, results: StudyResults) -> dict[str, Any]:
    interval, answer = ratio_answer(results, ratio)
    return {
        "estimate": ratio.estimate,
        "target": ratio.target,
        "relative_error": ratio.relative_error,
        "interval": _interval(interval),
        **answer.as_dict(),
    }


def _derived(one: DerivedEstimate) -> dict[str, Any]:
    return {
        "value": one.value,
        "unit": one.unit,
        "interval": _interval(one.interval),
        **one.answer.as_dict(),
    }


def _interval(ends: tuple[float, float] | None) -> dict[str, float] | None:
    return None if ends is None else {"lower": ends[0], "upper": ends[1]}


def _score(score: Scores) -> dict[str, float | None]:
    return {
        "jc": score.get("jc"),
        "mhd_mm": score.get("mhd_mm"),
        "mhd_voxels": score.get("mhd_voxels"),
        "gsf": score.get("gsf"),
    }


def _genes(genes: Mapping[str, float], spec: StudySpec) -> dict[str, Any]:
    return quantities_json(quantities_at_door(spec.case.parameters, genes))


def _evaluation(record: EvaluationRecord, spec: StudySpec) -> dict[str, Any]:
    return {
        "candidate": record.candidate,
        "generation": record.generation + 1,
        "status": record.status,
        "reason": record.reason,
        "genes": _genes(record.genes, spec),
        "score": record.score,
        "digest": record.digest,
    }


def _generation(generation: GenerationResult, spec: StudySpec) -> dict[str, Any]:
    record: dict[str, Any] = {
        "number": generation.number + 1,
        "asked": generation.evaluations,
        "ended": generation.ended,
        "complete": generation.scores is not None,
    }
    if generation.scores is None:
        return record
    scores = asdict(generation.scores)
    return record | scores | {"best_genes": _genes(scores["best_genes"], spec)}


def _stage(time: StageTime) -> dict[str, float]:
    return {"total": time.total_s, "mean": time.mean_s, "count": time.count}
