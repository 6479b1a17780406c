"""Processes that the tests start and kill."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from palpate.service.cluster.dask_cluster import ALLOWED_FAILURES
from tests.recovery.stand_ins import set_manners, told

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def kill_and_finish(folder: Path, where: list[str], killed_after: list[int]) -> None:
    """Kill a driver with signal 9 at given numbers of endings, and let the last one finish.

    Evaluations take 0.1 s, and at most eight more than the given number are finished.
    """
    command = [sys.executable, str(HERE / "driver.py"), str(folder), *where]
    store = folder.parent / "store"
    for count in killed_after:
        set_manners(store, seconds=0.1, held_after=count + 8)
        driver = subprocess.Popen(command)
        try:
            while len(told(folder)) < count:
                assert driver.poll() is None, "the driver ended before it was killed"
                time.sleep(0.02)
        finally:
            driver.kill()
            driver.wait()
    set_manners(store, seconds=0.1)
    subprocess.run(command, check=True, timeout=120)


@contextmanager
def plain_cluster(
    folder: Path, workers: int, tls: Mapping[str, str] | None = None
) -> Iterator[str]:
    """Run `dask scheduler` and `dask worker` as separate processes, and yield the address.

    With the environment `tls` they are encrypted.
    """
    port = unused_port()
    protocol = "tls" if tls else "tcp"
    address = f"{protocol}://127.0.0.1:{port}"
    environment = (
        os.environ
        | (tls or {})
        | {
            "PYTHONPATH": str(ROOT),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(ALLOWED_FAILURES),
        }
    )
    dask = [sys.executable, "-m", "dask"]
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    scheduler += ["--protocol", protocol]
    worker = ["worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory"]
    with (folder / "log").open("w") as log:
        started = [
            subprocess.Popen(dask + arguments, env=environment, stdout=log, stderr=log)
            for arguments in [scheduler, *([[*worker, str(folder / "dask")]] * workers)]
        ]
    try:
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            with suppress(subprocess.TimeoutExpired):
                process.wait(timeout=10)
            process.kill()


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
