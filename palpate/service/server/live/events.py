"""A job as server-sent events: its state, and the records of its journal.

::

    event: job       the job as /jobs/ID gives it, when it has changed, once a second at most
    event: record    a record of the journal; its id goes into Last-Event-ID to continue
    event: end       the last event
    event: problem   the journal is damaged; the last event
    event: points    compact records on request; see `points`

A stream continues from an offset of the journal, so it survives a restart of the service.
"""

import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable

from anyio import sleep
from fastapi.concurrency import run_in_threadpool

from palpate.service.server.api import JobView
from palpate.service.server.live.journal_tail import JournalLine, JournalTail
from palpate.service.server.live.points import points
from palpate.service.server.public_text import public
from palpate.storage.errors import PalpateError

TICK_S = 0.25
VIEW_EVERY_S = 1.0
KEEP_ALIVE_S = 15.0
ENDED = {"finished", "failed", "cancelled"}


async def job_events(
    tail: JournalTail,
    view: Callable[[], JobView],
    gone: Callable[[], Awaitable[bool]],
    *,
    brief: bool = False,
) -> AsyncIterator[bytes]:
    """Yield the events of a job.

    Parameters
    ----------
    tail : JournalTail
        The tail of its journal, from the client's offset.
    view : callable
        Returns the current state of the job.
    gone : callable
        Whether the client or the service is about to stop.
    brief : bool
        Send the chart data of many records at once instead of the records.
    """
    before: JobView | None = None
    viewed = sent = 0.0
    while not await gone():
        now = time.monotonic()
        try:
            # If the job ended before the journal was read, the journal is complete.
            current = await run_in_threadpool(view) if now - viewed >= VIEW_EVERY_S else None
            lines = await run_in_threadpool(tail.read)
        except PalpateError as error:
            yield _event("problem", {"error": public(str(error))})
            return
        if lines:
            yield _in_brief(lines) if brief else _in_full(lines)
            sent = now
        if current is not None and not lines:
            viewed = now
            if current != before:
                yield _event("job", current.model_dump(mode="json"))
                before, sent = current, now
            if current.state in ENDED:
                yield _event("end", {})
                return
        if now - sent > KEEP_ALIVE_S:
            yield b": still here\n\n"
            sent = now
        if not lines:
            await sleep(TICK_S)


async def all_job_events(
    news: Callable[[], list[JobView]], gone: Callable[[], Awaitable[bool]]
) -> AsyncIterator[bytes]:
    """Yield every changed job in `news`, once a second."""
    viewed = sent = 0.0
    while not await gone():
        now = time.monotonic()
        if now - viewed >= VIEW_EVERY_S:
            viewed = now
            jobs = await run_in_threadpool(news)
            if jobs:
                sent = now
                yield b"".join(_event("job", job.model_dump(mode="json")) for job in jobs)
        if now - sent > KEEP_ALIVE_S:
            yield b": still here\n\n"
            sent = now
        await sleep(TICK_S)


def _in_full(lines: list[JournalLine]) -> bytes:
    return b"".join(_event("record", line.record, line.end) for line in lines)


def _in_brief(lines: list[JournalLine]) -> bytes:
    return _event("points", points(line.record for line in lines), lines[-1].end)


def _event(kind: str, data: object, identifier: int | None = None) -> bytes:
    head = f"event: {kind}\n" + (f"id: {identifier}\n" if identifier is not None else "")
    return f"{head}data: {json.dumps(data, separators=(',', ':'))}\n\n".encode()
