"""Adaptive clusters: more workers under load, fewer when idle, the same journal."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster import dask_cluster
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, set_manners, told

PATIENCE_S = 120.0


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "ADAPT_EVERY_S", 0.1)
    monkeypatch.setattr(dask_cluster, "IDLE_S", 1.0)


def until(reached: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not reached():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


@contextmanager
def running(folder: Path, client: Any) -> Iterator[None]:
    """Run a study in the background, and wait for its end."""
    failed: list[BaseException] = []

    def study() -> None:
        try:
            run(folder, Dispatcher(client))
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=study)
    thread.start()
    try:
        yield
    finally:
        set_manners(folder.parent / "store")
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert failed == []


def assert_as_calm(folder: Path, calm: Path) -> None:
    assert told(folder) == told(calm)
    endings = StudyLog.read(StudyLayout(folder).journal).endings.values()
    assert {record.attempts for record in endings} == {1}


@pytest.mark.slow
def test_workers_follow_the_work(tmp_path: Path) -> None:
    calm, folder = tmp_path / "calm" / "demo", tmp_path / "runs" / "demo"
    run(calm, Inline())
    set_manners(folder.parent / "store", held_after=3)
    with open_cluster(workers="1-3") as cluster:
        client, local = cluster.client, cluster.client.cluster
        assert len(client.nthreads()) == 1
        with running(folder, client):
            until(lambda: len(client.nthreads()) == 3, "three workers under load")
            until(lambda: all(w.processing for w in workers_of(local)), "all of them busy")
            # One is retired while it computes; another may start, as there is work for three.
            retired = max(workers_of(local), key=lambda worker: worker.name)
            local.sync(local._adaptive.scale_down, [retired.name])
            assert retired.address not in [worker.address for worker in workers_of(local)]
            assert len(told(folder)) < 52
        assert told(folder) == told(calm)
        endings = StudyLog.read(StudyLayout(folder).journal).endings.values()
        assert {record.attempts for record in endings} == {1}  # none counts as lost
        assert_each_ran_once(folder)
        until(lambda: len(client.nthreads()) == 1, "one worker when idle")
        time.sleep(0.5)
        assert len(client.nthreads()) == 1


def workers_of(local: Any) -> list[Any]:
    """Return the scheduler's workers."""
    return list(local.scheduler.workers.values())
