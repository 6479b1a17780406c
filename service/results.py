"""What a study has found so far, as one record that JSON can hold.

Status, report and page all read this. Everything comes from the study's journal;
nothing is computed anew, and the study may be running meanwhile. Scores that are
infinite are the texts "-inf" and "inf".
"""

import fcntl
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from service.chronicle import Chronicle, read_study
from service.course import Course, Step, replay
from service.search.base import Generation
from service.spec import StudySpec
from service.study import best_of
from storage.errors import InputError
from storage.layout import StudyLayout
from storage.plain import to_plain
from storage.records import EvaluationRecord
from storage.status import Status
from workers.spec import validated

Json = dict[str, Any]
SCORES = ("jc", "mhd_mm", "mhd_voxels", "gsf")


def study_results(folder: Path) -> Json:
    """Everything that a status or a report tells of a study.

    Parameters
    ----------
    folder : Path
        Of the study.

    Returns
    -------
    dict
        ``study``, ``state`` ("running", "stopped" or "interrupted"), ``stopped`` (reason or
        None), ``estimates`` by parameter, ``score``, ``best`` (candidate), ``evaluations``
        (counts), ``generations``, ``failures``, ``per_label`` and
        ``per_label_before`` (scores of best and undeformed body), ``seconds`` (wall time of all
        runs), ``stages`` (seconds of computed evaluations), ``facts`` (of body and mesh),
        ``versions``, ``store``, ``folder`` and ``config`` (the study with all defaults).

    Raises
    ------
    InputError
        If `folder` is no study.
    JournalError
        If its journal is damaged.
    """
    study, told = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    best = best_of(told.endings)
    last = told.sessions[-1] if told.sessions else None
    found = {
        "study": spec.name,
        "state": _state(folder, told),
        "stopped": None if told.end is None else told.end.reason,
        "estimates": _estimates(spec, best),
        "score": {name: best.score.get(name) if best and best.score else None for name in SCORES},
        "best": None if best is None else _short(best),
        "evaluations": _counts(told.endings.values()),
        "generations": _generations(spec, told),
        "failures": [_short(r) for _, r in sorted(told.endings.items()) if r.reason],
        "per_label_before": {} if told.end is None else told.end.before,
        "per_label": {} if told.end is None else told.end.per_label,
        "seconds": told.seconds,
        "stages": _stages(told.endings.values()),
        "facts": {} if last is None else last.prepared.get("facts", {}),
        "target_kind": None if last is None else last.target.get("kind"),
        "sessions": len(told.sessions),
        "versions": study.versions if last is None else last.versions,
        "store": None if last is None else last.store,
        "folder": str(folder.absolute()),
        "config": spec.as_dict(),
    }
    return dict(to_plain(found))


def candidate_results(folder: Path, candidate: int | None) -> Json:
    """All that is known of one candidate; of the best one when None.

    An elite has the ending of the candidate that it was carried over from, whose
    number is then ``evaluated_as``.

    Raises
    ------
    InputError
        If there is no such candidate.
    """
    study, told = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    if candidate is None:
        best = best_of(told.endings)
        if best is None:
            raise _no_such("best candidate", folder, "no candidate has a score yet")
        candidate = best.candidate
    steps = [step for step, _ in _replayed(spec, told)]
    size = spec.search.population
    if not 0 <= candidate < size * len(steps):
        count = f"its candidates are 0 to {size * len(steps) - 1} so far"
        raise _no_such(f"candidate {candidate}", folder, count)
    step = steps[candidate // size]
    origin = candidate
    while (before := steps[origin // size].carried_from(origin)) is not None:
        origin = before
    ending = told.endings.get(origin)
    found: Json = {
        "study": spec.name,
        "candidate": candidate,
        "generation": step.number,
        "evaluated_as": origin,
        "genes": step.genes(candidate),
    }
    if ending is None:
        return dict(to_plain(found | {"status": str(Status.WAITING)}))
    names = ("status", "score", "reason", "traceback", "outcome", "seconds", "worker")
    told_of = {name: getattr(ending, name) for name in (*names, "attempts", "reused", "digest")}
    return dict(to_plain(found | told_of))


def _no_such(what: str, folder: Path, why: str) -> InputError:
    return InputError(f"The study {folder} has no {what}: {why}.")


def _replayed(spec: StudySpec, told: Chronicle) -> list[tuple[Step, Generation | None]]:
    course = Course(spec.search_strategy, spec.search.space.names)
    return list(replay(course, told.endings))


def _estimates(spec: StudySpec, best: EvaluationRecord | None) -> Json:
    vocabulary = spec.case.parameters
    truth: dict[str, float] = {}
    if spec.target.constants is not None:
        hidden = spec.case.complete(vocabulary.from_door(spec.target.constants))
        known = {name: value for name, value in hidden.items() if name in vocabulary}
        truth = vocabulary.to_door(known) | dict(spec.target.constants)
    estimates: Json = {}
    for name, bounds in spec.search.parameters.items():
        value = None if best is None else best.genes[name]
        true = truth.get(name)
        error = None if value is None or not true else abs(value - true) / true
        parameter = vocabulary.at_door(name)
        estimates[parameter.name] = {
            "gene": name,
            "estimate": value,
            "target": true,
            "relative_error": error,
            "unit": parameter.unit.symbol,
            "bounds": list(bounds),
        }
    return estimates


def _generations(spec: StudySpec, told: Chronicle) -> list[Json]:
    rows = []
    for step, generation in _replayed(spec, told):
        ended = [c for c in step.candidates if c in told.endings]
        row: Json = {
            "number": step.number,
            "asked": len(step.candidates),
            "ended": len(ended),
            "complete": generation is not None,
        }
        if generation is not None:
            index = generation.best
            finite = generation.scores[np.isfinite(generation.scores)]
            row |= {
                "best": float(generation.scores[index]),
                "mean": float(finite.mean()) if len(finite) else None,
                "best_candidate": step.first + index,
                "best_genes": step.genes(step.first + index),
                "failed": int(np.isposinf(generation.scores).sum()),
            }
        rows.append(row)
    return rows


def _counts(endings: Iterable[EvaluationRecord]) -> Json:
    endings = list(endings)
    by_status = Counter(str(record.status) for record in endings)
    counts: Json = {s: by_status[s] for s in ("done", "diverged", "crashed", "lost")}
    return counts | {"reused": sum(record.reused for record in endings)}


def _stages(endings: Iterable[EvaluationRecord]) -> Json:
    """Where the time went, for evaluations that this study has computed."""
    spent: dict[str, list[float]] = {}
    for record in endings:
        if not record.reused:
            for stage, seconds in record.seconds.items():
                spent.setdefault(stage, []).append(seconds)
    return {
        stage: {"total": sum(all_), "mean": sum(all_) / len(all_), "count": len(all_)}
        for stage, all_ in spent.items()
    }


def _short(record: EvaluationRecord) -> Json:
    return {
        "candidate": record.candidate,
        "generation": record.generation,
        "status": str(record.status),
        "reason": record.reason,
        "genes": record.genes,
        "score": record.score,
        "digest": record.digest,
    }


def _state(folder: Path, told: Chronicle) -> str:
    if is_running(folder):
        return "running"
    return "interrupted" if told.end is None else "stopped"


def is_running(folder: Path) -> bool:
    """Whether a driver holds the study's journal."""
    try:
        handle = os.open(StudyLayout(folder).journal, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False
