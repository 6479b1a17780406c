"""Studies with a store in a bucket: the same journal as with a folder, even if the server fails.

The server is moto's, over HTTP; it is stopped during a study and restarted.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.task_dispatch import Ending
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import parse_spec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.journal import Journal
from tests.recovery.processes import HERE
from tests.recovery.stand_ins import Inline, executed, run, set_manners, small_spec, told
from tests.storage.object_server import ObjectServer

MOMENTS = ("began", "seconds", "elapsed_s", "store")
REAL = """
name: real
case: {reference: {phantom: {preset: 250ml, spacing_mm: 2}}, mesh: {nodes: 1200}}
target: {constants: {E_fat_kpa: 12, E_glandular_kpa: 30}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 4
  generations: 2
seed: 3
"""


def journal(folder: Path) -> list[Any]:
    """Return all records of a journal without times and locations, bit-exact."""
    return [without(record) for record in Journal.read(StudyLayout(folder).journal)]


def without(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without(item) for key, item in value.items() if key not in MOMENTS}
    return value


def test_journal_matches_a_local_store(bucket: str, tmp_path: Path) -> None:
    run(tmp_path / "local" / "demo", Inline())
    run(tmp_path / "runs" / "demo", Inline(), store=f"{bucket}/store")
    there = journal(tmp_path / "runs" / "demo")
    assert there == journal(tmp_path / "local" / "demo")
    assert not (tmp_path / "runs" / "store").exists()
    ran = executed(f"{bucket}/store")
    assert len(ran) == len(set(ran)) >= len({r["digest"] for r in there if "digest" in r})
    # A later run finds the store of the last run with its content.
    run(tmp_path / "again" / "demo", Inline(), store=f"{bucket}/store")
    assert told(tmp_path / "again" / "demo") == told(tmp_path / "runs" / "demo")
    assert executed(f"{bucket}/store") == ran
    last = Study(small_spec(), tmp_path / "runs" / "demo")
    assert str(last.store) == f"{bucket}/store"


@pytest.mark.slow
def test_real_evaluations_are_bit_identical(bucket: str, tmp_path: Path) -> None:
    spec = parse_spec(REAL, "the test's study", Path())
    for place, store in (("local", tmp_path / "store"), ("bucket", f"{bucket}/store")):
        Study(spec, tmp_path / place, store).run(Inline())
    assert journal(tmp_path / "bucket") == journal(tmp_path / "local")


class CutOff(Inline):
    """A runner that stops the server after some endings and restarts it some seconds later."""

    def __init__(self, server: ObjectServer, after: int, seconds: float) -> None:
        self._server, self._left = server, after
        self.back = threading.Timer(seconds, server.start)

    def run(
        self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        for ending in super().run(task, calls):
            yield ending
            self._left -= 1
            if self._left == 0:
                self._server.stop()
                self.back.start()


def cut_off(
    server: ObjectServer, folder: Path, store: str, after: int, seconds: float
) -> threading.Thread:
    """Stop the server at a given number of endings in the journal, then restart it."""

    def cutting() -> None:
        while len(told(folder)) < after:
            time.sleep(0.02)
        server.stop()
        time.sleep(seconds)
        server.start()
        set_manners(store, seconds=0.1)

    thread = threading.Thread(target=cutting)
    thread.start()
    return thread


def test_server_outage_only_costs_time(stoppable_server: ObjectServer, tmp_path: Path) -> None:
    run(tmp_path / "calm" / "demo", Inline())
    folder, store = tmp_path / "runs" / "demo", f"s3://{stoppable_server.new_bucket()}/store"
    cutting = CutOff(stoppable_server, after=10, seconds=3.0)
    began = time.monotonic()
    run(folder, cutting, store=store)
    cutting.back.join()
    assert time.monotonic() - began > 3.0
    assert journal(folder) == journal(tmp_path / "calm" / "demo")
    ran = executed(store)
    assert len(ran) == len(set(ran))


@pytest.mark.slow
def test_workers_wait_ten_seconds_for_the_server(
    stoppable_server: ObjectServer, tmp_path: Path
) -> None:
    """The driver and two workers are separate processes, as started by `palpate run`."""
    run(tmp_path / "calm" / "demo", Inline())
    folder, store = tmp_path / "runs" / "demo", f"s3://{stoppable_server.new_bucket()}/store"
    set_manners(store, seconds=0.1, held_after=20)  # so the outage starts before the end
    command = [sys.executable, str(HERE / "driver.py"), str(folder), "--workers", "2", store]
    with subprocess.Popen(command) as driver:
        cutting = cut_off(stoppable_server, folder, store, after=10, seconds=10.0)
        assert driver.wait(180) == 0
        cutting.join()
    assert told(folder) == told(tmp_path / "calm" / "demo")
    assert {ending[3] for ending in told(folder).values()} <= {"done", "diverged"}
    ran = executed(store)
    assert len(ran) == len(set(ran))
