"""Results as the JSON records printed by `--json`, and as columns of equal length.

Scripts depend on the keys. Infinite scores are the strings "-inf" and "inf". A parameter is
``{"value": 10.0, "unit": "kPa"}``. Generations are counted from 1, as on the console and on the
page.

Evaluations, generations and estimates can be read as columns.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.service.number_formatting import quantities_at_door, quantities_json
from palpate.service.results.identification import Identification, RatioEstimate
from palpate.service.results.result_records import (
    CandidateResults,
    DerivedEstimate,
    GenerationResult,
    ParameterEstimate,
    StageTime,
    StudyResults,
    derived_estimates,
    ratio_answer,
)
from palpate.service.study.study_keys import StudySpec
from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.storage.json_digests import to_plain
from palpate.storage.values import Scores


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
        "derived": {estimate.name: _derived(estimate) for estimate in derived_estimates(results)},
        "stages": {stage: _stage(time) for stage, time in results.stages.items()},
        "facts": results.body_facts,
        "target_kind": results.target_kind,
        "sessions": results.sessions,
        "unverified_records": results.unverified_records,
        "unchained_records": results.unchained_records,
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


Columns = dict[str, NDArray[Any]]
SCORE_COLUMNS = ("jc", "mhd_mm", "gsf")


def evaluation_columns(
    endings: Mapping[int, EvaluationRecord], parameters: Mapping[str, Any]
) -> Columns:
    """Return the evaluations that have ended, in the order of the candidates.

    Parameters
    ----------
    endings : mapping of int to EvaluationRecord
        Endings by candidate.
    parameters : mapping
        The searched parameters by their names in the study file.
    """
    records = [record for _, record in sorted(endings.items())]
    columns: Columns = {
        "candidate": np.array([r.candidate for r in records], dtype=np.int64),
        "generation": np.array([r.generation for r in records], dtype=np.int64),
        "status": np.array([str(r.status) for r in records]),
    }
    for name in parameters:
        columns[name] = np.array([r.genes[name] for r in records], dtype=np.float64)
    for name in SCORE_COLUMNS:
        values = [np.nan if r.score is None else float(r.score[name]) for r in records]
        columns[name] = np.array(values, dtype=np.float64)
    columns["reason"] = np.array([r.reason for r in records])
    return columns


def generation_columns(results: StudyResults) -> Columns:
    """Return the generations; ``best`` and ``mean`` are NaN until all scores are known."""
    rows = results.generations
    scores = [g.scores for g in rows]
    best = [np.nan if s is None else s.best for s in scores]
    mean = [np.nan if s is None or s.mean is None else s.mean for s in scores]
    columns: Columns = {
        "generation": np.array([g.number for g in rows], dtype=np.int64),
        "evaluations": np.array([g.evaluations for g in rows], dtype=np.int64),
        "ended": np.array([g.ended for g in rows], dtype=np.int64),
        "best": np.array(best, dtype=np.float64),
        "mean": np.array(mean, dtype=np.float64),
    }
    for name in results.spec.search.parameters:
        values = [np.nan if s is None else s.best_genes[name] for s in scores]
        columns[name] = np.array(values, dtype=np.float64)
    return columns


def estimate_columns(results: StudyResults) -> Columns:
    """Return the searched parameters with their intervals and whether they may be quoted."""
    rows = list(results.estimates.values())

    def numbers(values: list[float | None]) -> NDArray[np.float64]:
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)

    return {
        "parameter": np.array([e.gene for e in rows]),
        "unit": np.array([e.unit for e in rows]),
        "estimate": numbers([e.estimate for e in rows]),
        "lower": numbers([None if e.interval is None else e.interval[0] for e in rows]),
        "upper": numbers([None if e.interval is None else e.interval[1] for e in rows]),
        "target": numbers([e.target for e in rows]),
        "quotable": np.array([e.quotable for e in rows], dtype=bool),
        "reasons": np.array(["; ".join(e.reasons) for e in rows]),
    }
