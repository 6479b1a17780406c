"""Jobs as server-sent events: their state, and the records of their journals.

::

    event: job       the job as /jobs/ID gives it, when it has changed, once a second at most
    event: record    a record of the journal; its id goes into Last-Event-ID to continue
    event: end       the last event
    event: problem   the journal is damaged; the last event
    event: points    compact records on request; see `points`

A stream continues from an offset of the journal, so it survives a restart of the service. The
number of streams is limited.

Of the compact records, which charts and counters use, an evaluation becomes
``[candidate, generation, status, score, [genes], reason]``; the view of the job has the best one.
A record of 1 kB shrinks to 80 bytes, and many are sent in one event, so that a page loads 20,000
evaluations in a second or two.
"""

import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from typing import Any

from anyio import sleep
from fastapi import HTTPException, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from palpate.service.server.api_models import JobView, public_text
from palpate.service.server.http.request_checks import still_reads
from palpate.service.server.job_progress import JournalLine, JournalTail
from palpate.service.server.running_service import Service
from palpate.storage.errors import PalpateError

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
            brief["evaluations"].append(_point(record, list(genes.values())))
        elif kind == "step":
            brief["steps"].append([record.get(key) for key in ("phase", "done", "of", "task")])
        elif kind == "session":
            brief["sessions"] += 1
    return brief


def _point(record: Mapping[str, Any], genes: list[Any]) -> list[Any]:
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
            yield _event("problem", {"error": public_text(str(error))})
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


Gone = Callable[[], Awaitable[bool]]


def event_stream(
    request: Request, service: Service, events: Callable[[Gone], AsyncIterator[bytes]]
) -> StreamingResponse:
    """Return a response that sends `events` until they end or client or service stop.

    Raises
    ------
    HTTPException
        503 if too many clients are following jobs.
    """
    state = request.app.state
    if state.streams >= service.limits.open_streams:
        raise HTTPException(503, "Too many clients are following jobs; try again later.")

    async def gone() -> bool:
        if state.stopping() or await request.is_disconnected():
            return True
        return not still_reads(request, service)

    async def stream() -> AsyncIterator[bytes]:
        state.streams += 1
        try:
            async for event in events(gone):
                yield event
        finally:
            state.streams -= 1

    return StreamingResponse(
        stream(), media_type="text/event-stream", headers={"X-Accel-Buffering": "no"}
    )
