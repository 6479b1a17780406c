"""Dask workers as jobs of a batch system, with a local scheduler, through dask-jobqueue.

Each job is one worker: a process, a thread and a core. The nodes that run the jobs need the
same installation and access to the store.
"""

import os
import re
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import dask
from distributed import Security
from tornado.ioloop import PeriodicCallback

from palpate.service.cluster.certificates import ROLES
from palpate.service.cluster.cluster_choice import WorkerRange, Workers
from palpate.service.cluster.dask_cluster import CONFIG, follow_the_work
from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.backends.atomic_files import explained
from palpate.storage.errors import InputError
from palpate.workers import WORKER_ENVIRONMENT

DEATH_TIMEOUT_S = 300
LOOK_EVERY_S = 5.0
GONE_S = 60.0

BatchSystem = Literal["slurm", "pbs", "lsf", "sge"]

_WITH_SECONDS = re.compile(r"(?P<minutes>\d+:\d\d):\d\d")


@dataclass(frozen=True)
class _Dialect:
    """Properties in which batch systems differ.

    Parameters
    ----------
    cluster : str
        Name of the class in dask-jobqueue.
    submit, cancel : str
        Programs of the batch system.
    payer : str
        Keyword of dask-jobqueue for the account.
    """

    cluster: str
    submit: str
    cancel: str
    payer: str = "account"


_DIALECTS: dict[BatchSystem, _Dialect] = {
    "slurm": _Dialect("SLURMCluster", "sbatch", "scancel"),
    "pbs": _Dialect("PBSCluster", "qsub", "qdel"),
    "lsf": _Dialect("LSFCluster", "bsub", "bkill", payer="project"),
    "sge": _Dialect("SGECluster", "qsub", "qdel", payer="project"),
}


@dataclass(frozen=True)
class JobRequest:
    """Workers as jobs of a batch system.

    Parameters
    ----------
    system : {"slurm", "pbs", "lsf", "sge"}
    workers : int or WorkerRange
        Number of jobs; within a range, the number follows the amount of work.
    memory : str
        Memory of each job, such as ``"4GB"``; a worker that needs more is terminated. It is not
        requested from SGE, because the name of the resource differs between sites.
    walltime : str
        Time limit of a job, such as ``"24:00:00"``.
    queue, account : str, optional
        Queue or partition, and the account that is charged.
    options : tuple of str
        Additional options of the submit command, such as ``"--exclusive"``.
    setup : tuple of str
        Shell commands before the worker starts, such as ``"module load python"``.
    host : str, optional
        Address of this machine that the workers can reach; default: found by Dask.
    port : int
        Port of the scheduler; 0 for any free port.
    logs : Path, optional
        Folder for the output of the jobs.
    """

    system: BatchSystem
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
class JobCluster:
    """A running scheduler with the jobs of its workers.

    Parameters
    ----------
    address : str
        Address of the scheduler; begins with ``tls://`` if Dask is configured with certificates.
    dashboard : str
        Address of Dask's dashboard.
    script : str
        Script of a job.
    """

    address: str
    dashboard: str
    script: str
    _workers: Workers
    _cluster: Any

    def submit(self) -> None:
        """Submit the requested jobs; jobs that end are resubmitted."""
        if isinstance(self._workers, WorkerRange):
            follow_the_work(self._cluster, self._workers)
        else:
            self._cluster.scale(jobs=self._workers)

    @property
    def running(self) -> int:
        """Number of connected workers."""
        return len(self._cluster.scheduler_info["workers"])


def check_batch_system(system: BatchSystem) -> None:
    """Check that jobs can be submitted from this machine.

    Raises
    ------
    ClusterError
        If the commands of the batch system are not installed.
    """
    dialect = _DIALECTS[system]
    for program in (dialect.submit, dialect.cancel):
        if shutil.which(program) is None:
            raise ClusterError(
                f"There is no {program} on this machine: run this where jobs are submitted, "
                "such as the login node of the cluster. --dry-run shows the job script anywhere."
            )


@contextmanager
def open_jobs(request: JobRequest) -> Iterator[JobCluster]:
    """Start the scheduler, and cancel all jobs on exit.

    Raises
    ------
    InputError
        If dask-jobqueue is not installed.
    ClusterError
        If the scheduler cannot be started, or a certificate cannot be read.
    """
    try:
        import dask_jobqueue
    except ImportError:
        raise InputError(
            "Workers as jobs need dask-jobqueue, which is not installed: "
            "pip install 'palpate[jobqueue]'."
        ) from None
    dialect = _DIALECTS[request.system]
    if request.logs is not None:
        with explained(request.logs):
            request.logs.mkdir(parents=True, exist_ok=True)
    with dask.config.set(CONFIG), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # from dask-jobqueue, about unused options
        try:
            cluster = getattr(dask_jobqueue, dialect.cluster)(
                cores=1,
                processes=1,
                memory=request.memory,
                walltime=_walltime(request),
                queue=request.queue,
                job_name="palpate",
                death_timeout=DEATH_TIMEOUT_S,
                job_extra_directives=list(request.options),
                job_script_prologue=[*request.setup, *_exports()],
                log_directory=None if request.logs is None else str(request.logs.absolute()),
                scheduler_options=_scheduler_options(request),
                security=_security(),
                silence_logs="critical",
                **{dialect.payer: request.account},
            )
        except (OSError, RuntimeError, ValueError) as error:
            raise ClusterError(
                f"The scheduler cannot be started: {error}. Give another --host or --port."
            ) from error
        with cluster, _submitted_again(cluster):
            yield JobCluster(
                cluster.scheduler_address,
                cluster.dashboard_link,
                cluster.job_script().replace("dummy-name", f"{dialect.cluster}-0"),
                request.workers,
                cluster,
            )


def _walltime(request: JobRequest) -> str:
    """Return the time limit in the format of the batch system; LSF accepts no seconds."""
    timed = _WITH_SECONDS.fullmatch(request.walltime)
    return timed["minutes"] if timed and request.system == "lsf" else request.walltime


def _security() -> Security | None:
    """Return the certificates of Dask's configuration, to be written into the job script.

    Some batch systems do not pass environment variables on to jobs.

    Raises
    ------
    ClusterError
        If a certificate cannot be read.
    """
    security = Security()
    try:
        contexts = [security.get_connection_args(r).get("ssl_context") for r in ROLES]
    except OSError as error:
        raise ClusterError(
            f"A certificate cannot be read: {error}. Check the paths in "
            "DASK_DISTRIBUTED__COMM__TLS__...; `palpate certs` creates certificates."
        ) from error
    return security if all(contexts) else None


class _EndedJobs:
    """Resubmission of jobs whose worker connected and has been missing for `GONE_S`.

    A batch system ends a job at its time limit, or for a more urgent one, and neither Dask nor
    dask-jobqueue replaces it. If only the worker died, its nanny restarts it sooner.
    """

    def __init__(self, cluster: Any) -> None:
        self._cluster = cluster
        self._gone_since: dict[Any, float] = {}
        self._came_up: set[Any] = set()

    async def submit_again(self) -> None:
        """Check the workers once; called in the cluster's own thread."""
        cluster, now = self._cluster, time.monotonic()
        there = {worker.name for worker in cluster.scheduler.workers.values()}
        self._came_up = (self._came_up | there) & cluster.worker_spec.keys()
        gone = {n: self._gone_since.get(n, now) for n in self._came_up - there}
        ended = [n for n, since in gone.items() if now - since >= GONE_S and n in cluster.workers]
        self._gone_since = {n: since for n, since in gone.items() if n not in ended}
        self._came_up -= set(ended)
        for name in ended:
            with suppress(Exception):  # the batch system no longer knows the job
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


def _scheduler_options(request: JobRequest) -> dict[str, Any]:
    options: dict[str, Any] = {"port": request.port, "dashboard_address": ":0"}
    return options if request.host is None else options | {"host": request.host}


def _exports() -> list[str]:
    """Return shell commands that set the environment of a local cluster's workers.

    See `service.cluster.dask_cluster`.
    """
    environment = dict(WORKER_ENVIRONMENT) | {"PYTHONSAFEPATH": "1"}
    for key, value in CONFIG.items():
        if key.startswith("distributed.worker."):
            environment["DASK_" + key.upper().replace(".", "__").replace("-", "_")] = str(value)
    if "PYTHONPATH" in os.environ:
        environment["PYTHONPATH"] = os.environ["PYTHONPATH"]
    return [f"export {name}='{value}'" for name, value in environment.items()]
