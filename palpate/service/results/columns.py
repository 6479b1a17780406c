"""Evaluations, generations and estimates of a study as columns of equal length."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.service.results.record import StudyResults
from palpate.storage.records.record import EvaluationRecord

Columns = dict[str, NDArray[Any]]
SCORES = ("jc", "mhd_mm", "gsf")


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
    for name in SCORES:
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
