"""A deadline for evaluations, enforced by ending the process.

A cancelled future keeps running, and a compiled kernel ignores signals. So the worker process ends
itself, its nanny starts another, and the scheduler sends the task again. The overrun is recorded in
the store first; after `MOST_OVERRUNS` of them the evaluation ends with that reason. Processes
without a nanny are left alone, because nothing would restart them.
"""

import os
import threading
from collections.abc import Callable, Iterable

from distributed import get_worker

from palpate.storage.backends.store_paths import Place
from palpate.storage.store import backend_of, load_evaluation, open_store
from palpate.storage.values import EvaluationRequest, EvaluationResult
from palpate.workers.resources import worker_name

MOST_OVERRUNS = 2
EXIT_CODE = 75

Evaluate = Callable[[EvaluationRequest], EvaluationResult]


def evaluate_within(
    deadline_s: float, evaluate: Evaluate, request: EvaluationRequest
) -> EvaluationResult:
    """Evaluate a candidate within `deadline_s` seconds.

    Returns
    -------
    dict
        The result of `evaluate`, or diverged if the deadline was overrun `MOST_OVERRUNS` times. The
        latter depends on the machine too, so it is not stored.
    """
    store = open_store(request["store"])
    numbers = range(1, MOST_OVERRUNS + 1)
    overruns = [store.layout.overrun(request["digest"], number) for number in numbers]
    before = [place for place in overruns if backend_of(place).is_file(place)]
    if len(before) == MOST_OVERRUNS and load_evaluation(store, request["digest"]) is None:
        _remove(before)  # another study may have a longer deadline
        return {
            "digest": request["digest"],
            "status": "diverged",
            "reason": f"no result within {deadline_s:g} s in any of {MOST_OVERRUNS} attempts",
            "score": None,
            "outcome": {},
            "constants": dict(request["constants"]),
            "seconds": {"overrun": MOST_OVERRUNS * deadline_s},
            "worker": worker_name(),
            "reused": False,
        }
    if not _has_nanny():
        return evaluate(request)
    this_time = overruns[min(len(before), MOST_OVERRUNS - 1)]
    timer = threading.Timer(deadline_s, _end_process, (this_time,))
    timer.daemon = True
    timer.start()
    try:
        result = evaluate(request)
    finally:
        timer.cancel()
    _remove(before)
    return result


def _remove(places: Iterable[Place]) -> None:
    for place in places:
        backend_of(place).remove(place)


def _has_nanny() -> bool:
    try:
        return get_worker().nanny is not None
    except ValueError:  # not a worker but the user's own process
        return False


def _end_process(overrun: Place) -> None:
    backend_of(overrun).create(overrun, b"")
    os._exit(EXIT_CODE)
