"""Random kills: workers, even while they start, the scheduler once, the service twice.

With a store in a bucket, its server is also down for 10 s.

300 evaluations through the real path, with tasks that take no time. Every evaluation ends
exactly once, and the journal equals that of an undisturbed run.
"""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from palpate.service.cluster.dask_cluster import ALLOWED_FAILURES
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.journal import Journal
from tests.recovery.processes import ROOT, unused_port
from tests.recovery.stand_ins import SPEC, Inline, executed, run, set_manners, small_spec, told
from tests.service.server.service_process import ServiceProcess
from tests.storage.object_server import ObjectServer

STUDIES = {
    name: SPEC.replace("name: demo", f"name: {name}")
    .replace("seed: 7", f"seed: {seed}")
    .replace("population: 12", "population: 33")
    for name, seed in (("left", 1), ("right", 2))
}
KILLS, WHILE_STARTING = 10, 3


class Kept:
    """Processes that are restarted when they end, as by an orchestrator."""

    def __init__(self, folder: Path, workers: int) -> None:
        self.port = unused_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        worker = ["worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        patient = ["--death-timeout", "30", "--local-directory", str(folder / "dask")]
        self._commands = [
            ["scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"],
            *([[*worker, *patient]] * workers),
        ]
        self._environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(ALLOWED_FAILURES),
        }
        self._log = (folder / "cluster.log").open("w")
        self._over = threading.Event()
        self.processes = [self._start(command) for command in self._commands]
        self._keeper = threading.Thread(target=self._keep)
        self._keeper.start()

    def _start(self, command: list[str]) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *command],
            env=self._environment,
            stdout=self._log,
            stderr=self._log,
        )

    def _keep(self) -> None:
        while not self._over.wait(0.1):
            for number, process in enumerate(self.processes):
                if process.poll() is not None and not self._over.is_set():
                    self.processes[number] = self._start(self._commands[number])

    def kill(self, number: int) -> None:
        with suppress(ProcessLookupError):
            self.processes[number].send_signal(signal.SIGKILL)

    def close(self) -> None:
        self._over.set()
        self._keeper.join()
        for process in self.processes:
            process.kill()
            process.wait()
        self._log.close()


def endings(home: Path) -> int:
    journals = [StudyLayout(home / name).journal for name in STUDIES]
    return sum(j.read_bytes().count(b'"kind":"evaluation"') for j in journals if j.exists())


@pytest.mark.slow
@pytest.mark.timeout(600)  # a minute
@pytest.mark.parametrize("place", ["folder", "bucket"])
def test_every_evaluation_ends_exactly_once(
    place: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    for name, text in STUDIES.items():
        run(tmp_path / "calm" / name, Inline(), small_spec(text))
    calm = {name: told(tmp_path / "calm" / name) for name in STUDIES}
    assert sum(map(len, calm.values())) == 2 * (33 + 4 * 31) > 300

    home = tmp_path / "runs"
    objects = request.getfixturevalue("stoppable_server") if place == "bucket" else None
    store = f"s3://{objects.new_bucket()}/store" if objects else str(home / "store")
    set_manners(store, seconds=0.05)
    cluster = Kept(tmp_path, workers=2)
    port = unused_port()
    service = ServiceProcess(home, ["--scheduler", cluster.address], port, f"--store={store}")
    try:
        service.start()
        with service.client() as client:
            jobs = {n: client.submit_study(t, key=n).id for n, t in STUDIES.items()}
            assert jobs == {name: name for name in STUDIES}
        assert len(own_processes(tmp_path, cluster.address)) >= 3  # so it finds them
        torment(cluster, service, home, objects)
        with service.client() as client:
            for name, text in STUDIES.items():
                assert client.submit_study(text, key=name).id == name  # nothing is queued twice
                assert [event.kind for event in client.follow(name)][-1] == "end"
                assert client.job(name).state == "finished"
        assert service.stop() == 0
    finally:
        if service.process is not None and service.process.poll() is None:
            service.kill()
        cluster.close()

    for name in STUDIES:
        assert told(home / name) == calm[name]
        records = list(Journal.read(StudyLayout(home / name).journal))
        ended = Counter(r["candidate"] for r in records if r["kind"] == "evaluation")
        assert set(ended.values()) == {1}
        for kind in ("identification", "end"):
            assert sum(r["kind"] == kind for r in records) == 1
    # Nothing is orphaned: all evaluations are journalled, and no process remains.
    finished = {ending[2] for name in STUDIES for ending in told(home / name).values()}
    # Fits at the best candidate have their own records, as in an undisturbed run.
    fits = set(executed(tmp_path / "calm" / "store")) - finished
    assert len(fits) == 2 * len(STUDIES)
    assert set(executed(store)) - finished <= fits
    assert not own_processes(tmp_path, cluster.address)


def own_processes(folder: Path, address: str) -> list[list[str]]:
    """Return the commands of all processes that name this test's folder or scheduler.

    Children of this process are not enough: those of a service that was killed are no longer
    its own, and a service of other tests or a resource tracker does not belong to this test.
    """
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.NoSuchProcess, psutil.AccessDenied):
            command = process.cmdline()
            named = any(str(folder) in word or address in word for word in command)
            if named and process.pid != os.getpid():
                found.append(command)
    return found


def cut_off(objects: ObjectServer) -> None:
    """Stop the object store for 10 s while the kills continue."""
    objects.stop()
    threading.Timer(10.0, objects.start).start()


def torment(
    cluster: Kept, service: ServiceProcess, home: Path, objects: ObjectServer | None
) -> None:
    """Kill workers at random, the first while they start, and everything else in between."""
    chance = random.Random(3)
    on_the_way = {40: "service", 100: "scheduler", 180: "service"}
    if objects is not None:
        on_the_way[140] = "objects"
    kills, deadline = 0, time.monotonic() + 400
    while (kills < KILLS or on_the_way) and time.monotonic() < deadline:
        # Often shorter than the start of a worker, which is then killed while starting.
        time.sleep(chance.uniform(0.3, 1.8))
        ended = endings(home)
        if on_the_way and ended >= min(on_the_way):
            victim = on_the_way.pop(min(on_the_way))
            if victim == "scheduler":
                cluster.kill(0)
            elif victim == "objects" and objects is not None:
                cut_off(objects)
            else:
                service.kill()
                service.start()
        elif kills < min(KILLS, WHILE_STARTING + ended // 20):
            cluster.kill(chance.choice([1, 2]))
            kills += 1
    assert kills == KILLS
    assert not on_the_way, f"only {endings(home)} evaluations have ended"
