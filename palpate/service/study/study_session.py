"""Sessions: workers are opened for one piece of work, stopped by Ctrl-C, and closed.

A session sends the records of its study to the cluster's scheduler as events, for
`cluster.dask_dashboard`.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from distributed import Client

from palpate.service.cluster.cluster_choice import Workers
from palpate.service.cluster.dask_cluster import open_cluster, prepare_client
from palpate.service.cluster.dask_dashboard import TOPIC
from palpate.service.cluster.task_dispatch import Dispatcher, SingleProcess, TaskRunner
from palpate.service.errors_and_interrupts import Interrupted, stop_requests
from palpate.service.search.search_interface import Generation
from palpate.service.study.study_events import Observer, StudyFacts
from palpate.storage.best_candidate import BestSoFar, score_of
from palpate.storage.errors import InputError
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.values import PreparedBody, PreparedTarget

SEND_EVERY_S = 0.5

_log = logging.getLogger(__name__)


class SchedulerEvents:
    """A background sender of records as events of the scheduler, topic `TOPIC`.

    One event is a list of records in chronological order.

    Parameters
    ----------
    client : distributed.Client
        Connected to the scheduler. Events lost because it stops are not an error.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._waiting: list[dict[str, Any]] = []
        self._sent = time.monotonic()
        self._turn = asyncio.Lock()

    @property
    def are_due(self) -> bool:
        """Return True if nothing has been sent for `SEND_EVERY_S`."""
        return time.monotonic() - self._sent >= SEND_EVERY_S

    def add(self, record: dict[str, Any]) -> None:
        """Add a record to the next event."""
        self._waiting.append(record)

    def send(self) -> None:
        """Send the pending records."""
        records, self._waiting = self._waiting, []
        self._sent = time.monotonic()
        self._client.loop.add_callback(self._log_event, records)

    async def _log_event(self, records: list[dict[str, Any]]) -> None:
        event = {"client": self._client.id, "records": records}
        async with self._turn:  # or Dask would send two at once, on two connections
            try:
                await self._client.scheduler.log_event(topic=TOPIC, msg=event)
            except Exception as error:
                _log.debug("%d records have not reached the scheduler: %r", len(records), error)


class DaskRecords(Observer):
    """Observer that sends events to the scheduler; endings at most every `SEND_EVERY_S`.

    Parameters
    ----------
    client : distributed.Client
        See `SchedulerEvents`.
    """

    def __init__(self, client: Client) -> None:
        self._events = SchedulerEvents(client)
        self._study = ""
        self._ranked = BestSoFar()

    def started(self, facts: StudyFacts) -> None:
        """Send the size of the study."""
        self._study = f"{socket.gethostname()}:{facts.folder}"
        self._add("started", name=facts.name, most=facts.most_evaluations)
        self._events.send()

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Do nothing: Dask shows these tasks itself."""

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Send the start of a generation immediately."""
        self._add("generation begun", number=number)
        self._events.send()

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Queue the ending of an evaluation, with its timings if it was computed now."""
        computed = not replayed and not record.reused
        self._ranked.add(record)
        best = self._ranked.record
        self._add(
            "ended",
            status=record.status.value,
            best_score=None if best is None else score_of(best),
            computed=computed,
            seconds=dict(record.seconds) if computed else {},
        )
        if self._events.are_due:
            self._events.send()

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Send the end of a generation immediately."""
        self._add("generation ended", number=number)
        self._events.send()

    def stopped(self, reason: str) -> None:
        """Send the reason why the search stopped."""
        self._add("stopped", reason=reason)
        self._events.send()

    def _add(self, what: str, **more: Any) -> None:
        self._events.add({"what": what, "study": self._study, **more})


Runner = TypeVar("Runner", bound=TaskRunner, covariant=True)


@dataclass(frozen=True)
class Session(Generic[Runner]):
    """The workers of a session.

    Parameters
    ----------
    dispatcher : TaskRunner
        Sends tasks to the workers.
    dashboard : str
        Address of Dask's page; empty if there is none.
    observers : tuple of Observer
        Observers for a study that runs on them.
    """

    dispatcher: Runner
    dashboard: str = ""
    observers: tuple[Observer, ...] = ()


@contextmanager
def session(
    scheduler: str | None = None, workers: Workers | str | None = None
) -> Iterator[Session[Dispatcher]]:
    """Open the workers of this machine or connect to a scheduler, until the work is done.

    Ctrl-C and SIGTERM stop the dispatcher, unless the calling program handles these signals
    itself.

    Parameters
    ----------
    scheduler, workers
        See `service.cluster.dask_cluster.open_cluster`.

    Raises
    ------
    Interrupted
        If the user asks to stop; finished tasks are saved.
    ClusterError, InputError
        As for `open_cluster`.
    """
    with stop_requests(respect_handlers=True) as requests:
        if requests:
            raise Interrupted
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            yield Session(dispatcher, cluster.dashboard, (DaskRecords(cluster.client),))


@contextmanager
def client_session(client: Client) -> Iterator[Session[Dispatcher]]:
    """Use the workers of a client, which stays open; Ctrl-C and SIGTERM as in `session`.

    Raises
    ------
    Interrupted
        If the user asks to stop; finished tasks are saved.
    ClusterError
        If scheduler or workers cannot import Palpate.
    """
    with stop_requests(respect_handlers=True) as requests:
        prepare_client(client)
        dispatcher = Dispatcher(client, stop=lambda: bool(requests))
        yield Session(dispatcher, client.dashboard_link or "", (DaskRecords(client),))


@contextmanager
def in_process_session() -> Iterator[Session[SingleProcess]]:
    """Run all tasks in this process, one at a time; Ctrl-C stops the current one."""
    yield Session(SingleProcess())


def chosen_session(
    *,
    workers: Workers | str | None = None,
    scheduler: str | None = None,
    client: Client | None = None,
    in_process: bool = False,
) -> AbstractContextManager[Session[TaskRunner]]:
    """Return the session for the workers chosen by the caller.

    Parameters
    ----------
    workers, scheduler
        See `session`, which is the default.
    client : distributed.Client, optional
    in_process : bool

    Raises
    ------
    InputError
        If more than one kind of workers is chosen.
    """
    choices = {
        "workers": workers is not None,
        "scheduler": scheduler is not None,
        "client": client is not None,
        "in_process": in_process,
    }
    chosen = [name for name, is_chosen in choices.items() if is_chosen]
    if len(chosen) > 1:
        raise InputError(f"Give one of {' and '.join(chosen)}: each chooses the workers.")
    if client is not None:
        return client_session(client)
    return in_process_session() if in_process else session(scheduler, workers)
