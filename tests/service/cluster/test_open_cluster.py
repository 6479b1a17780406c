"""Opening clusters: environment, replacement of workers, messages without a scheduler."""

import os
import signal
import socket
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from distributed import Client
from distributed.system import MEMORY_LIMIT

from palpate.service.cluster import dask_cluster as cluster_module
from palpate.service.cluster.certificates import temporary_security
from palpate.service.cluster.dask_cluster import CONFIG, free_port, open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import ClusterError, TaskError
from palpate.service.server.jobs.home_and_tokens import take_token
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


def test_local_cluster_runs_tasks_and_passes_on_errors() -> None:
    with open_cluster(workers=1) as cluster:
        assert cluster.local
        assert cluster.dashboard.startswith("http://127.0.0.1:")
        scheduler = cluster.client.cluster.scheduler
        assert scheduler.allowed_failures == CONFIG["distributed.scheduler.allowed-failures"]
        dispatcher = Dispatcher(cluster.client)
        assert dispatcher.threads == 1
        # Ctrl-C in a terminal also reaches the workers; they leave it to the driver.
        assert dispatcher.call(signals_of_process) == {"interrupts": False, "threads": "1"}
        assert signals_of_process()["interrupts"]
        # Errors that a user can correct come back unchanged; others come back as crashes.
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
        local.sync(local.workers[0].close)  # as after a failed restart
        assert Dispatcher(cluster.client, no_worker_s=30.0).call(signals_of_process)


def test_reports_a_missing_scheduler() -> None:
    with (
        pytest.raises(ClusterError, match="There is no scheduler at tcp://"),
        open_cluster("tcp://127.0.0.1:9", connect_s=0.5),
    ):
        pass


@pytest.mark.parametrize("address", ["not an address", "http://127.0.0.1:9", "x:y"])
def test_rejects_invalid_addresses(address: str) -> None:
    with (
        pytest.raises(ClusterError, match="There is no scheduler"),
        open_cluster(address, connect_s=0.5),
    ):
        pass


def test_free_port_avoids_a_taken_port() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        assert free_port(other.getsockname()[1]) == 0


def test_starts_if_another_process_takes_the_port_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Warnings are errors here, so one that Dask leaves on the way would end the start."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        monkeypatch.setattr(
            "palpate.service.cluster.dask_cluster.free_port", lambda preferred: taken
        )
        with open_cluster(workers=1) as cluster:
            assert cluster.client.run(int)
            assert f":{taken}/" not in str(cluster.client.dashboard_link)


def worker_environment() -> dict[str, Any]:
    return {name: os.environ.get(name) for name in ("PALPATE_TOKEN", "PYTHONSAFEPATH")}


def test_worker_environment_is_restored_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with open_cluster(workers=1) as cluster:
        assert Dispatcher(cluster.client).call(worker_environment)["PYTHONSAFEPATH"] == "1"
    assert worker_environment()["PYTHONSAFEPATH"] is None
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_local_cluster_refuses_other_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALPATE_TOKEN", "x" * 20)
    take_token()  # as the service does before it opens a cluster
    with open_cluster(workers=1) as cluster:
        address = cluster.client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        strangers = [(address.replace("tls", "tcp"), None), (address, temporary_security())]
        for place, security in strangers:
            with pytest.raises((OSError, TypeError)):
                Client(place, security=security, timeout=2, set_as_default=False)
        dispatcher = Dispatcher(cluster.client)
        assert dispatcher.call(worker_environment) == {"PALPATE_TOKEN": None, "PYTHONSAFEPATH": "1"}
        port = urlsplit(cluster.dashboard).port
        answers = {
            host: httpx.get(f"http://127.0.0.1:{port}/health", headers={"Host": host}).status_code
            for host in (f"127.0.0.1:{port}", "localhost", "evil.example", f"evil.example:{port}")
        }
        assert list(answers.values()) == [200, 200, 421, 421]
        limits = [w["memory_limit"] for w in cluster.client.scheduler_info()["workers"].values()]
        assert sum(limits) <= 0.8 * MEMORY_LIMIT
