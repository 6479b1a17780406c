"""Idle connections, and limits on concurrent requests."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

import httpx
import pytest
import uvicorn
from starlette.types import Receive, Scope, Send

from palpate.service.server.http.http_server import listen, url_of
from palpate.service.server.http.request_checks import Connection, RequestLimit, most_connections
from tests.service.server.service_process import ServiceProcess

HALF = b"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\n"


class Hasty(Connection):
    header_s, body_s = 0.4, 0.4


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Read the body, wait for the time in the path, and answer."""
    more = True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        more = message.get("more_body", False)
    await asyncio.sleep(float(scope["path"].strip("/") or 0))
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"here"})


@contextmanager
def served() -> Iterator[tuple[str, int]]:
    """Serve `echo` with short deadlines and at most two requests at once."""
    with listen("127.0.0.1", 0) as listening:
        config = uvicorn.Config(
            RequestLimit(echo, 2), http=Hasty, ws="none", lifespan="off", log_config=None
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        where = urlsplit(url_of(listening))
        try:
            yield str(where.hostname), int(where.port or 0)
        finally:
            server.should_exit = True
            thread.join(20)


def closed_within(connection: socket.socket, seconds: float) -> bool:
    connection.settimeout(seconds)
    try:
        while connection.recv(2**16):
            pass
    except TimeoutError:
        return False
    except ConnectionError:
        pass
    return True


@pytest.mark.parametrize(
    "start",
    [
        b"",
        HALF,
        b"G",
        b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\nab",
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\nGET / HT",
    ],
    ids=["nothing", "half a header", "a letter", "half a body", "a second header"],
)
def test_closes_idle_connections(start: bytes) -> None:
    with served() as where, socket.create_connection(where) as connection:
        connection.sendall(start)
        answered = b"\r\n\r\n" in start and b"POST" not in start
        assert closed_within(connection, 7 if answered else 4)  # kept for 5 s after an answer


def test_partial_header_does_not_extend_deadline() -> None:
    with served() as where, socket.create_connection(where) as connection:
        began = time.monotonic()
        with pytest.raises(ConnectionError):
            for byte in HALF * 20:
                connection.sendall(bytes([byte]))
                time.sleep(0.05)
        assert time.monotonic() - began < 3


def test_accepts_slow_body() -> None:
    with served() as where, socket.create_connection(where) as connection:
        connection.sendall(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 6\r\n\r\n")
        for _ in range(6):
            time.sleep(0.2)
            connection.sendall(b"x")
        connection.settimeout(5)
        assert connection.recv(2**16).startswith(b"HTTP/1.1 200")


def test_running_requests_are_limited_and_waiting_connections_are_not() -> None:
    with ExitStack() as stack:
        where = stack.enter_context(served())
        url = f"http://{where[0]}:{where[1]}"
        for _ in range(50):
            stack.enter_context(socket.create_connection(where))
        assert httpx.get(url).status_code == 200
        slow = [threading.Thread(target=httpx.get, args=(f"{url}/1",)) for _ in range(2)]
        for thread in slow:
            thread.start()
        time.sleep(0.4)
        assert httpx.get(url).status_code == 503
        assert httpx.get(f"{url}/0/health").status_code in (200, 500)
        for thread in slow:
            thread.join()
        assert httpx.get(url).status_code == 200


def test_closes_longest_waiting_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.service.server.http.request_checks.MOST_CONNECTIONS", 16)
    assert most_connections() == 16
    monkeypatch.setattr(Hasty, "header_s", 30.0)
    with ExitStack() as stack:
        where = stack.enter_context(served())
        waiting = [stack.enter_context(socket.create_connection(where)) for _ in range(16)]
        time.sleep(0.2)
        assert httpx.get(f"http://{where[0]}:{where[1]}").status_code == 200
        assert closed_within(waiting[0], 2)
        assert not closed_within(waiting[-1], 0.2)


def test_half_open_connections_do_not_block_others(service: ServiceProcess) -> None:
    where = urlsplit(service.url)
    with ExitStack() as stack:
        for number in range(530):
            connection = socket.create_connection((str(where.hostname), int(where.port or 0)))
            stack.enter_context(connection)
            connection.sendall(HALF if number % 2 else b"")
        took = []
        for _ in range(5):
            began = time.monotonic()
            assert httpx.get(f"{service.url}/api/v1/health", timeout=20).status_code == 200
            took.append(time.monotonic() - began)
        assert min(took) < 2  # the machine itself may be busy for a while
