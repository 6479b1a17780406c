"""Protection of Dask's dashboard against requests under other host names.

A page of another site can point its own name at this machine (DNS rebinding) and read the
replies. It cannot, however, forge the Host header.
"""

from collections.abc import Iterable
from typing import Any
from urllib.parse import urlsplit

from distributed import Scheduler
from tornado.httputil import (
    HTTPConnection,
    HTTPHeaders,
    HTTPMessageDelegate,
    HTTPServerConnectionDelegate,
    RequestStartLine,
    ResponseStartLine,
)

OWN = frozenset({"localhost", "127.0.0.1", "::1"})
REFUSAL = b"This dashboard answers to localhost only.\n"


def answer_to_own_hosts(scheduler: Scheduler, hosts: Iterable[str] = OWN) -> None:
    """Make the HTTP server of a scheduler reject requests for other hosts."""
    server: Any = scheduler.http_server
    server.request_callback = _OwnHosts(server.request_callback, frozenset(hosts))


class _OwnHosts(HTTPServerConnectionDelegate):
    """A delegate that passes on requests for allowed hosts only."""

    def __init__(self, inner: HTTPServerConnectionDelegate, hosts: frozenset[str]) -> None:
        self.inner, self.hosts = inner, hosts

    def start_request(
        self, server_conn: object, request_conn: HTTPConnection
    ) -> HTTPMessageDelegate:
        inner = self.inner.start_request(server_conn, request_conn)
        return _Checked(inner, request_conn, self.hosts)

    def on_close(self, server_conn: object) -> None:
        self.inner.on_close(server_conn)


class _Checked(HTTPMessageDelegate):
    """One request."""

    def __init__(
        self, inner: HTTPMessageDelegate, connection: HTTPConnection, hosts: frozenset[str]
    ) -> None:
        self.inner, self.connection, self.hosts = inner, connection, hosts
        self.refused = False

    def headers_received(
        self, start_line: RequestStartLine | ResponseStartLine, headers: HTTPHeaders
    ) -> Any:
        self.refused = _name(headers.get("Host", "")) not in self.hosts
        return None if self.refused else self.inner.headers_received(start_line, headers)

    def data_received(self, chunk: bytes) -> Any:
        return None if self.refused else self.inner.data_received(chunk)

    def finish(self) -> None:
        if not self.refused:
            self.inner.finish()
            return
        headers = HTTPHeaders({"Content-Length": str(len(REFUSAL)), "Content-Type": "text/plain"})
        start = ResponseStartLine("HTTP/1.1", 421, "Misdirected Request")
        self.connection.write_headers(start, headers, REFUSAL)
        self.connection.finish()

    def on_connection_close(self) -> None:
        if not self.refused:
            self.inner.on_connection_close()


def _name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
