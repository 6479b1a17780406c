"""An S3 server for tests that keeps its data when it is stopped and started again."""

import logging
import os
import random
import socket
import uuid
from contextlib import nullcontext
from threading import Lock
from typing import Any
from urllib.request import Request, urlopen

import pytest

KEYS = {
    "AWS_ACCESS_KEY_ID": "of-the-tests",
    "AWS_SECRET_ACCESS_KEY": "of-the-tests",
    "AWS_DEFAULT_REGION": "us-east-1",
}


class ObjectServer:
    """Moto's server in a thread, reached over HTTP at a local port."""

    def __init__(self) -> None:
        self._port, self._running = _steady_port(), None
        logging.getLogger("werkzeug").setLevel(logging.ERROR)

    @property
    def environment(self) -> dict[str, str]:
        return KEYS | {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._port}"}

    def start(self) -> None:
        from moto.server import ThreadedMotoServer

        self._running = ThreadedMotoServer("127.0.0.1", self._port, verbose=False)
        self._running.start()
        self._running._server.app = _one_write_at_a_time(self._running._server.app)

    def stop(self) -> None:
        if self._running is not None:
            self._running.stop()
            self._running._server.server_close()  # otherwise the port still accepts connections
            self._running = None

    def new_bucket(self) -> str:
        name = f"tests-{uuid.uuid4().hex[:12]}"
        url = f"{self.environment['AWS_ENDPOINT_URL']}/{name}"
        with urlopen(Request(url, method="PUT")):
            return name


def _one_write_at_a_time(app: Any) -> Any:
    """Serialise writes: moto checks for an object first and writes later, S3 does both at once."""
    writing = Lock()

    def called(environ: dict[str, Any], start_response: Any) -> Any:
        with writing if environ["REQUEST_METHOD"] in ("PUT", "POST") else nullcontext():
            return app(environ, start_response)

    return called


def _steady_port() -> int:
    """Return a free port that the system never assigns, so it stays free after a stop."""
    while True:
        port = random.randrange(20000, 30000)
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)):
                return port


def started() -> ObjectServer:
    """Return a running server; the test is skipped if moto or obstore is missing."""
    pytest.importorskip("obstore", reason="obstore is not installed: pip install 'palpate[cloud]'")
    pytest.importorskip("moto.server", reason="moto is not installed: pip install 'moto[server]'")
    server = ObjectServer()
    server.start()
    return server


def set_environment(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Point this process, and those that it starts, to this server and no other."""
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
