"""Clusters: what is set before they start, and what is said when there is none."""

import os
import signal
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster import open as cluster_module
from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.cluster.open import CONFIG, free_port, open_cluster
from palpate.service.errors import ClusterError, TaskError
from palpate.storage.errors import InputError


def signals_of_process() -> dict[str, Any]:
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return {"interrupts": signal.SIGINT not in blocked, "threads": os.environ["OMP_NUM_THREADS"]}


def fail(message: str) -> dict[str, Any]:
    raise InputError(message) if message else ZeroDivisionError("no message")


def meet(folder: str, own: str, other: str) -> dict[str, Any]:
    (Path(folder) / own).touch()
    end = time.monotonic() + 30.0
    while not (met := (Path(folder) / other).exists()) and time.monotonic() < end:
        time.sleep(0.02)
    return {"met": met}


def test_a_local_cluster() -> None:
    with open_cluster(workers=1) as cluster:
        assert cluster.local
        assert cluster.dashboard.startswith("http://127.0.0.1:")
        scheduler = cluster.client.cluster.scheduler
        assert scheduler.allowed_failures == CONFIG["distributed.scheduler.allowed-failures"]
        dispatcher = Dispatcher(cluster.client)
        assert dispatcher.threads == 1
        # Ctrl-C on a terminal goes to the workers, too; they leave it to the driver.
        assert dispatcher.call(signals_of_process) == {"interrupts": False, "threads": "1"}
        assert signals_of_process()["interrupts"]
        # What the user can put right comes back as it was raised; what he cannot, as a crash.
        with pytest.raises(InputError, match="choose another"):
            dispatcher.call(fail, "choose another")
        with pytest.raises(TaskError, match="fail failed: ZeroDivisionError"):
            dispatcher.call(fail, "")
    with pytest.raises(ClusterError, match="run the same command again"):
        Dispatcher(cluster.client).call(signals_of_process)


def test_a_worker_that_dask_has_given_up_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "MEND_EVERY_S", 0.2)
    with open_cluster(workers=1) as cluster:
        local = cluster.client.cluster
        local.sync(local.workers[0].close)  # as after a restart that failed
        assert Dispatcher(cluster.client, no_worker_s=30.0).call(signals_of_process)


def test_no_scheduler_at_an_address() -> None:
    with (
        pytest.raises(ClusterError, match="There is no scheduler at tcp://"),
        open_cluster("tcp://127.0.0.1:9", connect_s=0.5),
    ):
        pass


@pytest.mark.parametrize("address", ["not an address", "http://127.0.0.1:9", "x:y"])
def test_an_address_that_is_none(address: str) -> None:
    with (
        pytest.raises(ClusterError, match="There is no scheduler"),
        open_cluster(address, connect_s=0.5),
    ):
        pass


def test_a_taken_port_is_left_to_others() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        assert free_port(other.getsockname()[1]) == 0
