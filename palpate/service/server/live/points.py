"""Compact journal records for charts and counters.

An evaluation becomes ``[candidate, generation, status, score, [genes], reason]``; the
view of the job has the best one. A record of 1 kB shrinks to 80 bytes, and many are sent in one
event, so that a page loads 20,000 evaluations in a second or two.
"""

from collections.abc import Iterable, Mapping
from typing import Any

REASON_CHARACTERS = 200


def points(records: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return compact records.

    Returns
    -------
    dict
        ``genes``: names, ``evaluations``: rows as above, ``steps``: of a diagnosis as
        [phase, done, of, task], ``sessions``: number of new ones.
    """
    brief: dict[str, Any] = {"genes": [], "evaluations": [], "steps": [], "sessions": 0}
    for record in records:
        kind = record.get("kind")
        if kind == "evaluation":
            genes = record.get("genes") or {}
            brief["genes"] = list(genes)
            brief["evaluations"].append(_row(record, list(genes.values())))
        elif kind == "step":
            brief["steps"].append([record.get(key) for key in ("phase", "done", "of", "task")])
        elif kind == "session":
            brief["sessions"] += 1
    return brief


def _row(record: Mapping[str, Any], genes: list[Any]) -> list[Any]:
    reason = str(record.get("reason") or "").partition("\n")[0][:REASON_CHARACTERS]
    score = record.get("score") or {}
    return [
        record.get("candidate"),
        record.get("generation"),
        record.get("status"),
        score.get("objective", score.get("gsf")),
        genes,
        reason,
    ]
