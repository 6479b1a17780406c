"""Ends an evaluation that overruns its deadline: with its process, as nothing else stops it.

A future that is cancelled runs on, and a compiled kernel hears no signal. So the process of the
worker goes, its nanny starts another, and the scheduler sends the task again. What has overrun
is written into the store before; after `MOST_OVERRUNS` the evaluation has ended, with that as
its reason. Processes without a nanny are left alone, as nobody would start them again.
"""

import os
import threading
from collections.abc import Callable, Iterable

from distributed import get_worker

from palpate.storage.backends.contract import backend_of
from palpate.storage.backends.places import Place
from palpate.storage.records.evaluations import load_evaluation
from palpate.storage.records.tasks import EvaluationRequest, EvaluationResult
from palpate.storage.stores.store import open_store
from palpate.workers.resources import worker_name

MOST_OVERRUNS = 2
EXIT_CODE = 75

Evaluate = Callable[[EvaluationRequest], EvaluationResult]


def evaluate_within(
    deadline_s: float, evaluate: Evaluate, request: EvaluationRequest
) -> EvaluationResult:
    """Evaluate a candidate, in so many seconds.

    Returns
    -------
    dict
        As `evaluate` returns it; diverged if the deadline was overrun `MOST_OVERRUNS` times.
        That is no property of the candidate alone, so the store does not keep it.
    """
    store = open_store(request["store"])
    numbers = range(1, MOST_OVERRUNS + 1)
    overruns = [store.layout.overrun(request["digest"], number) for number in numbers]
    before = [place for place in overruns if backend_of(place).is_file(place)]
    if len(before) == MOST_OVERRUNS and load_evaluation(store, request["digest"]) is None:
        _remove(before)  # another study may have more patience
        return {
            "digest": request["digest"],
            "status": "diverged",
            "reason": f"no result within {deadline_s:g} s, tried {MOST_OVERRUNS} times",
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
    except ValueError:  # no worker, but the process of a user
        return False


def _end_process(overrun: Place) -> None:
    backend_of(overrun).create(overrun, b"")
    os._exit(EXIT_CODE)
