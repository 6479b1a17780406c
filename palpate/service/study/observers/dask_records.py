"""Records of a study as events of its cluster's scheduler, for `cluster.dask_tab`."""

import asyncio
import logging
import socket
import time
from typing import Any, Literal

from distributed import Client

from palpate.service.cluster.dask_rows import TOPIC
from palpate.service.search.base import Generation
from palpate.service.study.observers.hooks import Observer, StudyFacts
from palpate.storage.records.best_candidate import BestSoFar, score_of
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.tasks import PreparedBody, PreparedTarget

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
