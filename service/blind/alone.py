"""The task that diagnoses a whole case in one process."""

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from service.diagnosis.run import run
from service.dispatch import Asks, Ending, Task
from workers.casebook import Request

Record = dict[str, Any]


def diagnose_alone(request: Request) -> Record:
    """A whole diagnosis in this process; what it finds lies in the store.

    As many of these as there are workers keep all of them busy, while one diagnosis has
    phases of a single task; and each body is built by one process only.

    Returns
    -------
    dict
        ``seconds``.
    """
    begun = time.perf_counter()
    run(request, InThisProcess(), lambda *_: None)
    return {"seconds": time.perf_counter() - begun}


class InThisProcess:
    """A dispatcher for one who is a worker himself."""

    threads = 1

    def run(self, task: Task, asks: Asks) -> Iterator[Ending]:
        """Run tasks one after the other; what they raise goes up unchanged."""
        for key, arguments in asks:
            yield Ending(key, "returned", task(*arguments))

    def meanwhile(self, task: Task, asks: Asks) -> AbstractContextManager[None]:
        """There is nobody else to run them."""
        return nullcontext()
