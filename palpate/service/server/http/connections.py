"""Limits on connections and requests; idle connections are closed.

A client has `HEADER_S` seconds to send a complete header, and must send part of a body every
`BODY_S` seconds. Waiting connections do not count towards the limit of requests; if there are
too many, the one that has waited longest is closed for a new one.
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
"""Requests handled at once; event streams have a separate limit."""
MOST_CONNECTIONS = 4096
SPARE_FILES = 256
"""File descriptors reserved for the work itself."""


class Connection(H11Protocol):
    """A uvicorn connection that is closed when idle; see the top of this file."""

    header_s, body_s = HEADER_S, BODY_S
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start waiting for a header."""
        super().connection_made(transport)
        if len(self.connections) > most_connections():
            self._close_longest_waiting()
        self._wait(self.header_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Receive data, and wait for more unless a request is complete."""
        super().data_received(data)
        if self.is_waiting:
            if self._deadline is None:  # a partial header does not extend the deadline
                self._wait(self.header_s)
        elif self.conn.their_state is h11.SEND_BODY:
            self._stop_waiting()
            self._wait(self.body_s)
        else:
            self._stop_waiting()

    @property
    def is_waiting(self) -> bool:
        """Whether the connection waits for a header and no request is being answered."""
        return self.cycle is None or bool(self.cycle.response_complete)

    def _wait(self, seconds: float) -> None:
        self._deadline = self.loop.call_later(seconds, self._close)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _close(self) -> None:
        self._deadline = None
        if not self.is_waiting and self.flow.read_paused:  # the server has paused reading
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
    """Return the maximum number of connections that the limit of open files allows."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(16, min(MOST_CONNECTIONS, soft - SPARE_FILES))


def allow_open_files() -> None:
    """Raise this process's limit of open files as far as the system allows."""
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
        """Answer a request, or reject it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        if self.running >= self.most and not scope["path"].endswith("/health"):
            answer: Any = JSONResponse({"error": "Too many requests; try again later."}, 503)
            await answer(scope, receive, send)
            return
        self.running += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self.running -= 1
