"""Responses that stream server-sent events, limited in number."""

from collections.abc import AsyncIterator, Awaitable, Callable

from fastapi import HTTPException, Request
from fastapi.responses import StreamingResponse

from palpate.service.server.http.access import still_reads
from palpate.service.server.service import Service

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
