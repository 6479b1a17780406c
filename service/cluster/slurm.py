"""Starts a Dask scheduler here and its workers as jobs of SLURM, through dask-jobqueue.

One job is one worker: a process, a thread and a core. Where the jobs run they need the same
installation, and a file system that holds the store.
"""

import os
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
from tornado.ioloop import PeriodicCallback

from palpate.service.cluster.adaptive import follow_the_work
from palpate.service.cluster.open import CONFIG
from palpate.service.cluster.worker_range import WorkerRange, Workers
from palpate.service.errors import ClusterError
from palpate.storage.backends.atomic import explained
from palpate.storage.errors import InputError
from palpate.workers import WORKER_ENVIRONMENT

DEATH_TIMEOUT_S = 300
LOOK_EVERY_S = 5.0
GONE_S = 60.0


@dataclass(frozen=True)
class SlurmRequest:
    """What is asked of SLURM.

    Parameters
    ----------
    workers : int or WorkerRange
        Jobs; in a range as many as there is work for.
    memory : str
        Of each, such as ``"4GB"``; a worker that needs more is ended.
    walltime : str
        Such as ``"24:00:00"``.
    queue, account : str, optional
        Partition, and who pays.
    options : tuple of str
        Further options of sbatch: ``"--exclusive"``.
    setup : tuple of str
        Lines of shell before the worker starts: ``"module load python"``.
    host : str, optional
        Address of this machine that the workers can reach; default: found by Dask.
    port : int
        Of the scheduler; 0 takes any.
    logs : Path, optional
        Folder for what the jobs print.
    """

    workers: Workers
    memory: str = "4GB"
    walltime: str = "24:00:00"
    queue: str | None = None
    account: str | None = None
    options: tuple[str, ...] = ()
    setup: tuple[str, ...] = ()
    host: str | None = None
    port: int = 0
    logs: Path | None = None


@dataclass(frozen=True)
class SlurmCluster:
    """A scheduler that is running, whose workers are not submitted yet.

    Parameters
    ----------
    address : str
        Of the scheduler.
    dashboard : str
        Of Dask's page.
    script : str
        Of one job.
    """

    address: str
    dashboard: str
    script: str
    _workers: Workers
    _cluster: Any

    def submit(self) -> None:
        """Submit as many jobs as were asked for; those that end are submitted again."""
        if isinstance(self._workers, WorkerRange):
            follow_the_work(self._cluster, self._workers)
        else:
            self._cluster.scale(jobs=self._workers)

    @property
    def running(self) -> int:
        """Return how many workers have come up."""
        return len(self._cluster.scheduler_info["workers"])


@contextmanager
def open_slurm(request: SlurmRequest) -> Iterator[SlurmCluster]:
    """Start the scheduler; on leaving all jobs are cancelled.

    Raises
    ------
    InputError
        If dask-jobqueue is not installed.
    ClusterError
        If this machine has no SLURM, or the scheduler cannot be started.
    """
    try:
        from dask_jobqueue import SLURMCluster
    except ImportError:
        raise InputError(
            "SLURM needs dask-jobqueue, which is not installed: pip install 'palpate[slurm]'."
        ) from None
    for program in ("sbatch", "scancel"):
        if shutil.which(program) is None:
            raise ClusterError(
                f"There is no {program} on this machine: run this where jobs are submitted, "
                "such as the login node of the cluster."
            )
    if request.logs is not None:
        with explained(request.logs):
            request.logs.mkdir(parents=True, exist_ok=True)
    with dask.config.set(CONFIG), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # jobqueue's own, of options that are left out
        try:
            cluster = SLURMCluster(
                cores=1,
                processes=1,
                memory=request.memory,
                walltime=request.walltime,
                queue=request.queue,
                account=request.account,
                job_name="palpate",
                death_timeout=DEATH_TIMEOUT_S,
                job_extra_directives=list(request.options),
                job_script_prologue=[*request.setup, *_exports()],
                log_directory=None if request.logs is None else str(request.logs),
                scheduler_options=_scheduler_options(request),
                silence_logs="critical",
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise ClusterError(
                f"The scheduler for SLURM cannot be started: {error}. Give another --host or "
                "--port."
            ) from error
        with cluster, _submitted_again(cluster):
            yield SlurmCluster(
                cluster.scheduler_address,
                cluster.dashboard_link,
                cluster.job_script(),
                request.workers,
                cluster,
            )


class _EndedJobs:
    """Submits jobs again whose worker came up and has been gone for `GONE_S`.

    SLURM ends a job with its walltime, or for one that is more urgent. Neither Dask nor
    dask-jobqueue replaces it. Where only the worker died, its nanny is quicker.
    """

    def __init__(self, cluster: Any) -> None:
        self._cluster = cluster
        self._gone_since: dict[Any, float] = {}
        self._came_up: set[Any] = set()

    async def submit_again(self) -> None:
        """Look once; called in the cluster's own thread."""
        cluster, now = self._cluster, time.monotonic()
        there = {worker.name for worker in cluster.scheduler.workers.values()}
        self._came_up = (self._came_up | there) & cluster.worker_spec.keys()
        gone = {n: self._gone_since.get(n, now) for n in self._came_up - there}
        ended = [n for n, since in gone.items() if now - since >= GONE_S and n in cluster.workers]
        self._gone_since = {n: since for n, since in gone.items() if n not in ended}
        self._came_up -= set(ended)
        for name in ended:
            with suppress(Exception):  # SLURM knows the job no more
                await cluster.workers.pop(name).close()
        if ended:
            cluster.scale(len(cluster.worker_spec))  # as many as before


@contextmanager
def _submitted_again(cluster: Any) -> Iterator[None]:
    looking = PeriodicCallback(_EndedJobs(cluster).submit_again, 1000 * LOOK_EVERY_S)
    cluster.loop.add_callback(looking.start)
    try:
        yield
    finally:
        cluster.loop.add_callback(looking.stop)


def _scheduler_options(request: SlurmRequest) -> dict[str, Any]:
    options: dict[str, Any] = {"port": request.port, "dashboard_address": ":0"}
    return options if request.host is None else options | {"host": request.host}


def _exports() -> list[str]:
    """Return shell lines that give workers the environment of a local cluster's workers.

    See `service.cluster.open`.
    """
    environment = dict(WORKER_ENVIRONMENT) | {"PYTHONSAFEPATH": "1"}
    for key, value in CONFIG.items():
        if key.startswith("distributed.worker."):
            environment["DASK_" + key.upper().replace(".", "__").replace("-", "_")] = str(value)
    if "PYTHONPATH" in os.environ:
        environment["PYTHONPATH"] = os.environ["PYTHONPATH"]
    return [f"export {name}='{value}'" for name, value in environment.items()]
