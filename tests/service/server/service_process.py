"""A service in a separate process that tests start, kill and restart."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from palpate.service.remote_client import Client
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import JournalError
from palpate.storage.journal import Journal

TOKEN = "a-token-of-the-tests"
SERVED = Path(__file__).parent / "served.py"


class ServiceProcess:
    """See the top of this file; `where` is --workers N or --scheduler ADDRESS."""

    def __init__(self, home: Path, where: list[str], port: int = 0, *more: str) -> None:
        self.home, self.port = home, port
        self._command = [sys.executable, str(SERVED), str(home), *where]
        self._more = more
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, patience_s: float = 90.0) -> "ServiceProcess":
        address = self.home / "url"
        address.unlink(missing_ok=True)
        self.home.mkdir(parents=True, exist_ok=True)
        with (self.home.parent / "service.log").open("ab") as log:
            self.process = subprocess.Popen(
                [*self._command, str(self.port), *self._more],
                env=os.environ | {"PALPATE_TOKEN": TOKEN},
                stdout=log,
                stderr=log,
            )
        until = time.monotonic() + patience_s
        while not address.exists():
            assert self.process.poll() is None, self.log
            assert time.monotonic() < until, "the service did not start"
            time.sleep(0.05)
        return self

    @property
    def url(self) -> str:
        return (self.home / "url").read_text()

    @property
    def log(self) -> str:
        return (self.home.parent / "service.log").read_text()

    def client(self, token: str | None = TOKEN) -> Client:
        return Client(self.url, token or "")

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        assert self.process is not None
        self.process.terminate()
        return self.process.wait(timeout=90)


@contextmanager
def running_service(
    home: Path, where: list[str], *more: str, threads: int = 0
) -> Iterator[ServiceProcess]:
    """Start a service with a number of worker threads, and check that it ends cleanly."""
    served = ServiceProcess(home, where, 0, *more).start()
    until = time.monotonic() + 120
    try:
        with served.client() as client:
            while threads and client.cluster().threads < threads:
                assert time.monotonic() < until, client.cluster()
                time.sleep(0.1)
        yield served
    except BaseException:
        served.kill()
        raise
    assert served.process is not None
    assert served.process.poll() is None, "the service went down"
    assert served.stop() == 0
    assert "Traceback" not in served.log, served.log


def until_stopped(folder: Path, patience_s: float = 60.0) -> None:
    """Wait until no process or thread writes the journal of a study."""
    deadline = time.monotonic() + patience_s
    while True:
        with suppress(JournalError):
            return Journal(StudyLayout(folder).journal).close()
        assert time.monotonic() < deadline, "the study runs on"
        time.sleep(0.05)
