"""The HTTP server of a service, which runs until asked to stop."""

import socket
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext

import uvicorn

from palpate.service.server.http.app import create_app
from palpate.service.server.http.connections import Connection, allow_open_files
from palpate.service.server.http.guard import is_loopback
from palpate.service.server.service import Service
from palpate.storage.errors import InputError

GRACE_S = 3


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket; port 0 takes any free port.

    Raises
    ------
    InputError
        If the address is in use or does not belong to this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(256)
    except (OSError, OverflowError) as error:
        listening.close()
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"Cannot listen on {host}:{port}: {reason}. Choose another --port or --host."
        ) from error
    return listening


def url_of(listening: socket.socket) -> str:
    """Return the URL of a socket for a browser on this machine."""
    host, port = listening.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


class _Server(uvicorn.Server):
    """A server without signal handlers, so that no signal is lost while it starts."""

    def __init__(self, config: uvicorn.Config, stop: Callable[[], object]) -> None:
        super().__init__(config)
        self._stop = stop

    def capture_signals(self) -> AbstractContextManager[None]:  # type: ignore[override]
        return nullcontext()

    async def on_tick(self, counter: int) -> bool:
        if self._stop():
            self.should_exit = True
        return await super().on_tick(counter)


def serve(
    service: Service,
    listening: socket.socket,
    hosts: Iterable[str] = (),
    *,
    stop: Callable[[], object],
) -> None:
    """Serve until `stop` returns true; it is called ten times a second."""
    host = str(listening.getsockname()[0])
    if not is_loopback(host) and host not in ("0.0.0.0", "::"):
        hosts = {host, *hosts}
    app = create_app(service, hosts=hosts, stopping=lambda: server.should_exit)
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        lifespan="off",
        http=Connection,
        ws="none",
        timeout_graceful_shutdown=GRACE_S,
    )
    allow_open_files()
    server = _Server(config, stop)
    server.run(sockets=[listening])
