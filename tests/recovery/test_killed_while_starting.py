"""Worker processes killed with signal 9 while they start."""

import os
import threading
from contextlib import suppress

import psutil
import pytest

from palpate.service.cluster import dask_cluster as cluster_module
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import ClusterError


class Killer:
    """A thread that kills the first worker processes, or all, as soon as they appear."""

    def __init__(self, most: float) -> None:
        self.most, self.killed = most, set[int]()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._kill)

    def _kill(self) -> None:
        while len(self.killed) < self.most and not self._over.wait(0.01):
            for process in psutil.Process().children(recursive=True):
                with suppress(psutil.Error):
                    command = " ".join(process.cmdline())
                    new = process.pid not in self.killed and len(self.killed) < self.most
                    if new and "multiprocessing.spawn" in command:
                        process.kill()
                        self.killed.add(process.pid)

    def __enter__(self) -> "Killer":
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._over.set()
        self._thread.join()


def test_replaces_workers_killed_while_starting(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cluster_module, "MEND_EVERY_S", 0.2)
    with Killer(most=3) as killer, open_cluster(workers=2) as cluster:
        assert Dispatcher(cluster.client).call(os.getpid) not in killer.killed
        cluster.client.wait_for_workers(2, timeout=60)
    assert len(killer.killed) == 3
    assert "Traceback" not in capfd.readouterr().err


def test_no_worker_starting_gives_one_message(capfd: pytest.CaptureFixture[str]) -> None:
    with (
        Killer(most=float("inf")),
        pytest.raises(ClusterError, match="No worker process has started in 3 attempts"),
        open_cluster(workers=1),
    ):
        pass
    assert "Traceback" not in capfd.readouterr().err
