"""Connections that keep a slot without asking anything are closed; running requests are counted.

A client has `HEADER_S` seconds to send a complete header, and sends some of a body every
`BODY_S` seconds. Connections that only wait do not count towards the limit of requests, and when
there are very many, the one that has waited longest is closed for a new one.
"""

import asyncio
import resource
from contextlib import suppress
from typing import Any

import h11
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_S = 15.0
BODY_S = 60.0
MOST_REQUESTS = 256
"""Requests that are answered at once; those that follow events have a limit of their own."""
MOST_CONNECTIONS = 4096
SPARE_FILES = 256
"""File descriptors that are kept for the work itself."""


class Connection(H11Protocol):
    """A connection of uvicorn that is closed when nothing comes; see the top of this file."""

    header_s, body_s = HEADER_S, BODY_S
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a header."""
        super().connection_made(transport)
        if len(self.connections) > most_connections():
            self._close_longest_waiting()
        self._wait(self.header_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take data, and wait for more unless a request is complete."""
        super().data_received(data)
        if self.is_waiting:
            if self._deadline is None:  # more of a header gives no more time
                self._wait(self.header_s)
        elif self.conn.their_state is h11.SEND_BODY:
            self._stop_waiting()
            self._wait(self.body_s)
        else:
            self._stop_waiting()

    @property
    def is_waiting(self) -> bool:
        """Whether no request is being answered: a header is still to come."""
        return self.cycle is None or bool(self.cycle.response_complete)

    def _wait(self, seconds: float) -> None:
        self._deadline = self.loop.call_later(seconds, self._close)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _close(self) -> None:
        self._deadline = None
        if not self.is_waiting and self.flow.read_paused:  # it is us who read no more
            self._wait(self.body_s)
            return
        if not self.transport.is_closing():
            self.transport.abort()

    def _close_longest_waiting(self) -> None:
        waiting = [
            one
            for one in self.connections
            if isinstance(one, Connection) and one is not self and one.is_waiting and one._deadline
        ]
        if waiting:
            min(waiting, key=_deadline_of)._close()
        else:
            self._close()


def _deadline_of(connection: Connection) -> float:
    deadline = connection._deadline
    return 0.0 if deadline is None else deadline.when()


def most_connections() -> int:
    """Return how many connections may be open: what the limit of open files leaves room for."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(16, min(MOST_CONNECTIONS, soft - SPARE_FILES))


def allow_open_files() -> None:
    """Raise the limit of open files of this process as far as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_CONNECTIONS + SPARE_FILES
    if soft < wanted:
        allowed = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))


class RequestLimit:
    """Middleware that answers 503 while `most` requests are running.

    Parameters
    ----------
    app : ASGI application
    most : int
    """

    def __init__(self, app: ASGIApp, most: int = MOST_REQUESTS) -> None:
        self.app, self.most, self.running = app, most, 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if self.running >= self.most and not scope["path"].endswith("/health"):
            answer: Any = JSONResponse(
                {"error": "Too many requests at this moment: try again later."}, 503
            )
            await answer(scope, receive, send)
            return
        self.running += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self.running -= 1
