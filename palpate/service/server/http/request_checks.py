"""What a request passes before its route: limits, the origin, strict JSON, authentication.

Connections: a client has `HEADER_S` seconds to send a complete header, and must send part of a body
every `BODY_S` seconds; idle connections are closed. Waiting connections do not count towards the
limit of requests; if there are too many, the one that has waited longest is closed for a new one.

Origin: a page of another site can make a browser send requests to a service on this machine. It
cannot read the answers, and its writes are refused here even with valid credentials, because of
their Host (DNS rebinding), Origin and Sec-Fetch-Site headers. Every response gets the headers
`HEADERS`.

Bodies are JSON without repeated keys. Authentication is by a bearer token, or by the cookie that it
was exchanged for.
"""

import asyncio
import resource
from collections.abc import Callable, Coroutine, Iterable
from contextlib import suppress
from ipaddress import ip_address
from typing import Annotated, Any
from urllib.parse import urlsplit

import h11
from fastapi import Depends, HTTPException, Request, Response
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from palpate.service.server.api_models import SignIn
from palpate.service.server.jobs.home_and_tokens import Owner
from palpate.service.server.jobs.job_queue import Job
from palpate.service.server.running_service import Service
from palpate.storage.errors import InputError
from palpate.workers.input_files import parse_json

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


LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
}
POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "object-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'"
)


class Guard:
    """Middleware; see the top of this file.

    Parameters
    ----------
    app : ASGI application
    hosts : iterable of str
        Host names the service accepts, in addition to those of this machine.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str] = ()) -> None:
        self.app = app
        self.hosts = LOOPBACK | {host.lower() for host in hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or reject it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            status, why = refusal
            await JSONResponse({"error": why}, status)(scope, receive, _with_headers(send))
            return
        await self.app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        name = _host_name(host)
        if name is None or not (name in self.hosts or "*" in self.hosts):
            return 421, (
                f"This service does not accept the host name {host[:80]!r}. Start it with "
                "--allow-host NAME, or use the name of this machine."
            )
        if scope["method"] in SAFE_METHODS:
            return None
        origin, site = headers.get("origin"), headers.get("sec-fetch-site")
        foreign = origin is not None and _origin_place(origin) != host.lower()
        if foreign or (site is not None and site not in ("same-origin", "none")):
            return 403, "Pages of other sites cannot change anything here."
        return None


def _origin_place(origin: str) -> str:
    """Return host and port of an origin; empty if it is not valid."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _host_name(host: str) -> str | None:
    """Return the name in a Host header, without its port; None if it is not valid."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def is_loopback(host: str) -> bool:
    """Check whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("Content-Security-Policy", POLICY)
            headers.setdefault("Cache-Control", "no-store")
        await send(message)

    return sending


class _StrictRequest(Request):
    async def json(self) -> Any:
        """Return the parsed body.

        Raises
        ------
        HTTPException
            422 if a key is repeated, or the body is not JSON.
        """
        if not hasattr(self, "_json"):
            try:
                self._json = parse_json(await self.body(), "The request")
            except InputError as error:
                raise HTTPException(422, str(error)) from error
        return self._json


class StrictRoute(APIRoute):
    """A route that rejects JSON bodies with a repeated key."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of the route; see `APIRoute`."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(_StrictRequest(request.scope, request.receive))

        return handle


COOKIE = "palpate_token"
COOKIE_S = 30 * 24 * 3600

_bearer = HTTPBearer(auto_error=False, description="A token created by `palpate token new NAME`.")
Credentials = Annotated[HTTPAuthorizationCredentials | None, Depends(_bearer)]


def service_of(request: Request) -> Service:
    """Return the service of a request."""
    service: Service = request.app.state.service
    return service


Here = Annotated[Service, Depends(service_of)]


def owner_of(
    request: Request, service: Service, credentials: HTTPAuthorizationCredentials | None
) -> Owner | None:
    """Return the owner of a request's token; None without a valid token."""
    given = credentials.credentials if credentials else request.cookies.get(COOKIE, "")
    return service.tokens.holder(given) if given else None


def known(request: Request, service: Here, credentials: Credentials) -> Owner:
    """Return the owner of a request's token.

    Raises
    ------
    HTTPException
        401 without a valid token.
    """
    owner = owner_of(request, service, credentials)
    if owner is None:
        given = credentials or request.cookies.get(COOKIE)
        what = "This token is not valid" if given else "This needs a token"
        raise HTTPException(
            401,
            f"{what}: send `Authorization: Bearer TOKEN`. `palpate token new NAME` creates one.",
            {"WWW-Authenticate": "Bearer"},
        )
    return owner


def writer(owner: Annotated[Owner, Depends(known)]) -> Owner:
    """Return the owner of a token that allows writing.

    Raises
    ------
    HTTPException
        401 without a valid token, 403 with a read-only one.
    """
    if not owner.submits:
        raise HTTPException(
            403,
            f"The token {owner.name} is read-only. `palpate token new NAME --role submit` creates "
            "one that can upload and submit.",
        )
    return owner


def check_may_change(owner: Owner, job: Job) -> None:
    """Refuse a request to change a job by anyone but its owner or an admin.

    Raises
    ------
    HTTPException
        403
    """
    if not owner.may_change(job.owner):
        raise HTTPException(
            403,
            f"{job.id} was submitted by {job.owner}: only that token, or an admin's, "
            "can change it.",
        )


def still_reads(request: Request, service: Service) -> bool:
    """Check whether a request in progress would still be allowed to read."""
    if not service.read_token:
        return True
    scheme, _, given = request.headers.get("Authorization", "").partition(" ")
    token = given.strip() if scheme.lower() == "bearer" else request.cookies.get(COOKIE, "")
    return bool(token) and service.tokens.owner(token) is not None


def reader(request: Request, service: Here, credentials: Credentials) -> None:
    """Refuse a request without read access; without ``--read-token`` everyone has it.

    Raises
    ------
    HTTPException
        401 without a valid token.
    """
    if service.read_token:
        known(request, service, credentials)


Writer = Annotated[Owner, Depends(writer)]


def sign_in(service: Service, given: SignIn, response: Response, *, secure: bool) -> None:
    """Store a token in a cookie that scripts cannot read and other sites do not send.

    Raises
    ------
    HTTPException
        401 if the token is not valid.
    """
    if service.tokens.owner(given.token) is None:
        raise HTTPException(401, "This token is not valid.", {"WWW-Authenticate": "Bearer"})
    response.set_cookie(
        COOKIE, given.token, COOKIE_S, httponly=True, samesite="strict", secure=secure
    )
