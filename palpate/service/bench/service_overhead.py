"""Benchmarks of everything but the simulation: overhead, memory, and idle workers.

`soak` runs many trivial evaluations through a scheduler, workers and a service in separate
processes, as `palpate serve --scheduler` does. The others run a study on sleeping tasks.
"""

import os
import secrets
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Client as DaskClient
from distributed import LocalCluster

from palpate.service.bench.sleeping_tasks import TASKS, Durations, text_of
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import stop_requests
from palpate.service.remote_client import Client
from palpate.service.server.http.http_server import listen, serve, url_of
from palpate.service.server.jobs.home_and_tokens import TOKEN_VARIABLE
from palpate.service.server.running_service import open_service
from palpate.service.study.loop import Study
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import parse_spec
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from palpate.workers import WORKER_ENVIRONMENT

POPULATION = 200
# Workers, population, generations, durations of evaluations, modes. Two workers are processes,
# as on a workstation; larger numbers are threads of one worker, which sleep.
CASES: tuple[tuple[int, int, int, Durations, tuple[str, ...]], ...] = (
    (2, 84, 1, Durations(1.0), ("barrier",)),
    (12, 84, 4, Durations(1.0, 0.8), ("barrier", "steady")),
    (96, 192, 4, Durations(4.0, 0.8), ("barrier", "steady")),
)
MOST_PROCESSES = 4
PATIENCE_S = 120.0
SAMPLES = 20
# Share of the evaluations before memory is compared, while caches and allocators fill.
WARM_SHARE = 0.1


@dataclass(frozen=True)
class Soak:
    """The cost of many trivial evaluations.

    Parameters
    ----------
    evaluations : int
    seconds : float
        From the first to the last ending.
    overhead_ms : float
        Wall time per evaluation.
    memory_mb : dict of str to tuple of float
        Memory of service and scheduler, after the first tenth and at the end.
    """

    evaluations: int
    seconds: float
    overhead_ms: float
    memory_mb: dict[str, tuple[float, float]]

    def growth(self, process: str) -> float:
        """Return the relative growth of a process's memory."""
        first, last = self.memory_mb[process]
        return last / first - 1


def soak(evaluations: int, folder: Path, workers: int = 2) -> Soak:
    """Run many trivial evaluations through a service.

    Parameters
    ----------
    evaluations : int
        A multiple of 200.
    folder : Path
        An empty folder.
    """
    generations = evaluations // POPULATION
    if generations * POPULATION != evaluations or not generations:
        raise InputError(f"--evaluations must be a multiple of {POPULATION}, got {evaluations}.")
    home = folder / "runs"
    Durations().write(home / "store")
    with _processes(folder, home, workers) as (scheduler, service, client):
        client.submit_study(text_of("soak", POPULATION, generations))
        samples: list[tuple[int, float, float]] = []
        began = 0.0
        while (job := client.job("soak")).state in ("waiting", "running"):
            ended = 0 if job.evaluations is None else job.evaluations.done
            if ended and not began:
                began = time.monotonic()
            if len(samples) <= SAMPLES * ended // evaluations and ended >= WARM_SHARE * evaluations:
                samples.append((ended, _rss_mb(service), _rss_mb(scheduler)))
            time.sleep(0.2)
        samples.append((evaluations, _rss_mb(service), _rss_mb(scheduler)))
        if job.state != "finished":
            raise InputError(f"The study has {job.state}: {job.reason}")
        seconds = _wall_s(home / "soak")
    memory = {
        name: (samples[0][k], samples[-1][k]) for k, name in ((1, "service"), (2, "scheduler"))
    }
    return Soak(evaluations, seconds, 1000 * seconds / evaluations, memory)


def all_rows(evaluations: int) -> Iterator[dict[str, Any]]:
    """Yield every measurement: the soak, two workers, and 12 and 96 workers in either mode."""
    with tempfile.TemporaryDirectory(prefix="palpate-bench-") as folder:
        soaked = soak(evaluations, Path(folder))
    yield {
        "what": "soak",
        "evaluations": soaked.evaluations,
        "overhead_ms": round(soaked.overhead_ms, 2),
        **{f"{p}_mb": [round(mb, 1) for mb in both] for p, both in soaked.memory_mb.items()},
        **{f"{p}_growth": round(soaked.growth(p), 3) for p in soaked.memory_mb},
    }
    for workers, population, generations, durations, modes in CASES:
        for mode in modes:
            with tempfile.TemporaryDirectory(prefix="palpate-bench-") as folder:
                run = busy(workers, population, generations, durations, Path(folder), mode=mode)
            yield {
                "what": f"{workers} workers, {mode}",
                "evaluations": run.evaluations,
                "mean_s": durations.mean_s,
                "spread": durations.spread,
                "seconds": round(run.seconds, 1),
                "busy_share": round(run.busy_share, 3),
                "idle_share": round(1 - run.busy_share, 3),
            }


@dataclass(frozen=True)
class Busy:
    """Utilisation of workers by sleeping tasks."""

    mode: str
    workers: int
    evaluations: int
    seconds: float
    busy_share: float


def busy(
    workers: int,
    population: int,
    generations: int,
    durations: Durations,
    folder: Path,
    *,
    mode: str = "barrier",
) -> Busy:
    """Run a study of sleeping tasks on a given number of workers.

    Up to `MOST_PROCESSES` are processes; more are threads of one worker, since they only sleep.
    """
    durations.write(folder / "store")
    spec = parse_spec(text_of(mode, population, generations, mode=mode), "bench", Path())
    real = workers <= MOST_PROCESSES
    with (
        tempfile.TemporaryDirectory(prefix="palpate-bench-") as scratch,
        LocalCluster(
            n_workers=workers if real else 1,
            threads_per_worker=1 if real else workers,
            processes=real,
            local_directory=scratch,
            dashboard_address=":0",
            silence_logs="CRITICAL",
        ) as cluster,
        DaskClient(cluster, set_as_default=False) as client,
    ):
        client.wait_for_workers(workers if real else 1)
        Study(spec, folder / mode, folder / "store", tasks=TASKS).run(Dispatcher(client))
    log = StudyLog.read(StudyLayout(folder / mode).journal)
    computed = [r for r in log.endings.values() if not r.reused]
    slept = sum(sum(record.seconds.values()) for record in computed)
    seconds = _wall_s(folder / mode)
    return Busy(mode, workers, len(computed), seconds, slept / (workers * seconds))


def _wall_s(study: Path) -> float:
    """Return the time from the end of the preparation to the end of the study."""
    log = StudyLog.read(StudyLayout(study).journal)
    assert log.end is not None
    return log.end.elapsed_s - log.sessions[-1].seconds


@contextmanager
def _processes(
    folder: Path, home: Path, workers: int
) -> Iterator[tuple[subprocess.Popen[bytes], subprocess.Popen[bytes], Client]]:
    """Start scheduler, workers and service."""
    token, address = secrets.token_urlsafe(), _free_address()
    environment = os.environ | WORKER_ENVIRONMENT | {TOKEN_VARIABLE: token}
    dask = [sys.executable, "-m", "dask"]
    own = [sys.executable, "-m", "palpate.service.bench.service_overhead", str(home), address]
    port = address.rpartition(":")[2]
    commands = [
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"],
        own,
        *[[*dask, "worker", address, "--nthreads", "1", "--no-dashboard"]] * workers,
    ]
    started: list[subprocess.Popen[bytes]] = []
    try:
        with (folder / "log.txt").open("ab") as log:
            for command in commands:
                process: subprocess.Popen[bytes] = subprocess.Popen(
                    command, env=environment, stdout=log, stderr=log, cwd=folder
                )
                started.append(process)
        until = time.monotonic() + PATIENCE_S
        while not (home / "url").exists():
            if time.monotonic() > until or started[1].poll() is not None:
                raise InputError(f"The service did not start; see {folder / 'log.txt'}.")
            time.sleep(0.1)
        with Client((home / "url").read_text(), token) as client:
            yield started[0], started[1], client
    finally:
        for process in reversed(started):
            process.terminate()
        for process in started:
            process.wait(timeout=60)


def _free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


def _rss_mb(process: subprocess.Popen[bytes]) -> float:
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main(home: str, scheduler: str) -> None:
    """Serve sleeping tasks from a folder."""
    with (
        stop_requests() as requests,
        listen("127.0.0.1", 0) as listening,
        open_service(
            Path(home), lambda: open_cluster(scheduler), tasks=TASKS, reports=False
        ) as service,
    ):
        write_file(Path(home) / "url", url_of(listening).encode())
        serve(service, listening, stop=lambda: requests)


if __name__ == "__main__":
    main(*sys.argv[1:])
