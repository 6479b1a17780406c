"""The task that diagnoses a whole case in one process."""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, cast

from service.diagnosis.run import run
from service.dispatch import Dispatcher, Ending
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
    run(request, cast(Dispatcher, InThisProcess()), lambda *_: None)
    return {"seconds": time.perf_counter() - begun}


class InThisProcess:
    """A dispatcher for one who is a worker himself."""

    def run(
        self, task: Callable[..., Record], asks: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        """Run tasks one after the other; what they raise goes up unchanged."""
        for key, arguments in asks:
            yield Ending(key, "returned", task(*arguments))
