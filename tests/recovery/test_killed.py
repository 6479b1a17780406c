"""Real processes, killed on purpose with signal 9.

The reference is a run without any cluster that nobody disturbs.
"""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from service.cluster import CONFIG, free_port, open_cluster
from service.dispatch import Dispatcher
from stand_ins import Inline, assert_each_ran_once, executions, run, set_manners, told

DRIVER = Path(__file__).with_name("driver.py")
SECONDS = 0.15


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Any, ...]]:
    folder = tmp_path_factory.mktemp("reference") / "demo"
    run(folder, Inline())
    return told(folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    set_manners(tmp_path / "runs" / "store", seconds=SECONDS)
    return tmp_path / "runs" / "demo"


def test_five_workers_killed(folder: Path, reference: dict[int, tuple[Any, ...]]) -> None:
    """Finished evaluations are not run again; unfinished ones are asked for again."""
    killed = []

    def kill(client: Any) -> None:
        chance = random.Random(5)
        for _ in range(5):
            time.sleep(chance.uniform(0.3, 1.0))
            with suppress(Exception):  # a worker may be going at this moment
                pids = list(client.run(os.getpid, on_error="ignore").values())
                pid = chance.choice(sorted(pids))
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)

    with open_cluster(workers=2) as cluster:
        killer = threading.Thread(target=kill, args=(cluster.client,))
        killer.start()
        run(folder, Dispatcher(cluster.client))
        killer.join()
    assert len(killed) >= 4
    assert told(folder) == reference
    assert_each_ran_once(folder)


def test_driver_killed_three_times_with_its_own_cluster(
    folder: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    _kill_and_finish(folder, ["--workers", "2"], killed_after=[1, 8, 20])
    assert told(folder) == reference
    assert_each_ran_once(folder)


def test_driver_killed_three_times_beside_a_running_scheduler(
    folder: Path, tmp_path: Path, reference: dict[int, tuple[Any, ...]]
) -> None:
    """The plain processes of a compose file: `dask scheduler`, `dask worker`, a driver."""
    with plain_processes(tmp_path, workers=2) as address:
        _kill_and_finish(folder, ["--scheduler", address], killed_after=[2, 11, 23])
    assert told(folder) == reference
    # A worker that outlives its driver may finish what the next driver asks for again.
    assert len(executions(folder)) - len(set(executions(folder))) <= 3 * 2


def _kill_and_finish(folder: Path, where: list[str], killed_after: list[int]) -> None:
    command = [sys.executable, str(DRIVER), str(folder), *where]
    for count in killed_after:
        driver = subprocess.Popen(command)
        try:
            while len(told(folder)) < count:
                assert driver.poll() is None, "the driver ended before it was killed"
                time.sleep(0.02)
        finally:
            driver.kill()
            driver.wait()
    subprocess.run(command, check=True, timeout=60)


@contextmanager
def plain_processes(folder: Path, workers: int) -> Iterator[str]:
    """A scheduler and workers, each a process of its own."""
    port = free_port(0) or _some_port()
    address = f"tcp://127.0.0.1:{port}"
    environment = os.environ | {
        "PYTHONPATH": str(DRIVER.parent),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(
            CONFIG["distributed.scheduler.allowed-failures"]
        ),
    }
    dask = [sys.executable, "-m", "dask"]
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
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


def _some_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
