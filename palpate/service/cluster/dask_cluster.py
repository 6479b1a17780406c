"""Dask's cluster for a run: local processes, fixed or following the work, or a running scheduler.

One evaluation per process, one thread per evaluation. Worker processes are spawned, or forked
within `service.cluster.worker_startup.forked_workers`; either way a script that opens a cluster
needs ``if __name__ == "__main__":``.

A cluster may follow the work: one worker is wanted for each task on it. A dispatcher sends two
tasks for each worker (`service.cluster.task_dispatch`), so the number of workers doubles until
the maximum is reached or the work runs out. Only workers idle for `IDLE_S` are retired, so the
end of a generation, when few candidates are left, does not cost workers that the next generation
needs. Dask's own estimate uses the seconds of work in the queue, which are always few here.
"""

import logging
import os
import socket
import tempfile
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import dask
import dask.system
from distributed import Client, LocalCluster, Security, Status
from distributed.deploy import Adaptive
from distributed.system import MEMORY_LIMIT
from tornado.ioloop import PeriodicCallback

from palpate.service.cluster.certificates import temporary_security
from palpate.service.cluster.cluster_choice import (
    WorkerRange,
    Workers,
    check_reachable,
    most_workers,
    read_workers,
)
from palpate.service.cluster.dask_dashboard import add_tab, answer_to_own_hosts
from palpate.service.cluster.worker_failures import error_sentence, prepare_workers
from palpate.service.cluster.worker_startup import (
    SAFE_PATH,
    check_main_guard,
    lacks_guard,
    unheard_interrupts,
)
from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.errors import InputError
from palpate.workers import WORKER_ENVIRONMENT

ADAPT_EVERY_S = 1.0
IDLE_S = 60.0


class FollowTheWork(Adaptive):
    """Scaling of a cluster whose scheduler runs in this process; see the module docstring.

    Parameters
    ----------
    *arguments, **options
        As for Dask's ``Adaptive``; ``wait_count`` is the number of consecutive checks after which a
        superfluous worker is retired.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._targets: deque[int] = deque(maxlen=self.wait_count)

    async def target(self) -> int:
        """Return the number of tasks that run or wait for a worker."""
        scheduler = self.cluster.scheduler
        on_workers = sum(len(worker.processing) for worker in scheduler.workers.values())
        return on_workers + len(scheduler.queued) + len(scheduler.unrunnable)

    async def recommendations(self, target: int) -> dict[str, Any]:
        """Return the next scaling step, in Dask's format.

        Parameters
        ----------
        target : int
            Number of workers wanted now, within the bounds.
        """
        planned = set(self.plan)
        self._targets.append(target)
        if target > len(planned):
            return {"status": "up", "n": target}
        spare = len(planned) - max(self._targets)
        if spare == 0 or len(self._targets) < self.wait_count:
            return {"status": "same"}
        scheduler = self.cluster.scheduler
        idle = [w.name for w in scheduler.workers.values() if not w.processing]
        unneeded = [*planned.difference(self.observed), *sorted(planned.intersection(idle))]
        if not unneeded:
            return {"status": "same"}
        return {"status": "down", "workers": unneeded[:spare]}


def follow_the_work(cluster: Any, workers: WorkerRange) -> None:
    """Let a Dask cluster grow and shrink within a range until it is closed."""
    cluster.adapt(
        Adaptive=FollowTheWork,
        minimum=workers.least,
        maximum=workers.most,
        interval=ADAPT_EVERY_S,
        wait_count=max(1, round(IDLE_S / ADAPT_EVERY_S)),
    )


ALLOWED_FAILURES = 5
DASHBOARD_PORT = 8787
MEND_EVERY_S = 5.0
HANDSHAKE_S = 10.0
START_ATTEMPTS = 3
# Share of this machine's memory for all workers together; the rest is for everything else.
MEMORY_SHARE = 0.8
GIVEN_UP = {Status.closed, Status.failed}

# Read by the scheduler when it starts, so they have to be set first.
CONFIG: dict[str, Any] = {
    # A task is given up after this many deaths of its worker; most are not its fault.
    "distributed.scheduler.allowed-failures": ALLOWED_FAILURES,
    # A worker's memory is a deliberate cache without results: nothing to spill, no reason to
    # pause. It is stopped beyond 95 % of its share, before the kernel would choose a process.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.worker.use-file-locking": False,
    # After this long Dask would drop a worker, even one that is being restarted.
    "distributed.deploy.lost-worker-timeout": "10000 days",
    "distributed.admin.large-graph-warning-threshold": "1MB",
}
# Spawned workers import nothing from the folder in which they start.
SAFE_PATH_SETTING = {f"distributed.nanny.pre-spawn-environ.{SAFE_PATH}": "1"}


class _SteadyCluster(LocalCluster):
    """A local cluster that survives workers that come and go quickly or die while starting.

    Dask's own cluster fails with a KeyError when a worker ends that it never knew or has forgotten,
    and again when it is closed. A worker that dies is restarted by its nanny; a nanny that fails is
    not restarted, and its failure ends a cluster that is still starting.
    """

    failure = ""

    def _update_worker_status(self, op: str, msg: Any) -> None:
        if op != "remove" or msg in self.scheduler_info["workers"]:
            super()._update_worker_status(op, msg)

    async def _correct_state_internal(self) -> None:
        try:
            await super()._correct_state_internal()
        except Exception as error:
            self.failure = error_sentence(error.__cause__ or error)

    @property
    def has_workers(self) -> bool:
        """Return True if Dask has not given up all workers."""
        return any(worker.status not in GIVEN_UP for worker in self.workers.values())

    def forget_given_up(self) -> bool:
        """Forget nannies that have failed; return True if workers are missing."""
        for name in [n for n, worker in self.workers.items() if worker.status in GIVEN_UP]:
            del self.workers[name]
        return self.worker_spec.keys() > self.workers.keys()

    def mend(self) -> None:
        """Replace missing workers; called in the cluster's own thread."""
        if self.forget_given_up():
            self.scale(len(self.worker_spec))  # the same number as before

    def start_again(self) -> None:
        """Restart workers that did not start, and wait for them."""
        self.forget_given_up()
        self.sync(self._correct_state_internal)


@dataclass(frozen=True)
class Cluster:
    """A connection to the workers.

    Parameters
    ----------
    client : distributed.Client
        The client that sends tasks.
    dashboard : str
        Address of Dask's page; empty if there is none.
    local : bool
        Whether the processes were started here and end with this process.
    """

    client: Client
    dashboard: str
    local: bool


@contextmanager
def open_cluster(
    scheduler: str | None = None,
    workers: Workers | str | None = None,
    *,
    allowed_failures: int = ALLOWED_FAILURES,
    connect_s: float = 5.0,
) -> Iterator[Cluster]:
    """Start local workers or connect to a scheduler; close on exit whatever was opened.

    Parameters
    ----------
    scheduler : str, optional
        Address such as ``tcp://10.0.0.5:8786``. Default: a cluster on this machine.
    workers : int, WorkerRange or str, optional
        Number of local processes, >= 1; default: one per core. A range such as ``"1-8"``
        follows the work.
    allowed_failures : int
        Deaths of a worker after which the scheduler gives up a task (local only).
    connect_s : float
        How long to wait for a listener at `scheduler`.

    Raises
    ------
    ClusterError
        If the scheduler cannot be reached.
    InputError
        If both `scheduler` and `workers` are given, or there are too few workers.
    """
    if isinstance(workers, str):
        workers = read_workers(workers, "workers=")
    if isinstance(workers, int) and workers < 1:
        raise InputError(
            f"workers={workers}: at least one worker is needed. Omit it for one worker per core."
        )
    if scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes on this machine; --scheduler uses a running cluster: give "
            "one of them."
        )
    opened = (
        _existing(scheduler, connect_s)
        if scheduler is not None
        else _local(workers, allowed_failures)
    )
    with opened as cluster:
        prepare_client(cluster.client)
        yield cluster


def prepare_client(client: Client) -> None:
    """Limit workers to one thread, and add the Palpate tab to the dashboard, if any.

    Raises
    ------
    ClusterError
        If the scheduler or a worker cannot import Palpate.
    """
    prepare_workers(client)
    if client.dashboard_link:
        with _unlogged("distributed"):
            add_tab(client)


@contextmanager
def _existing(address: str, connect_s: float) -> Iterator[Cluster]:
    check_reachable(address, connect_s)
    _check_encryption(address)
    with _unlogged("distributed"):
        try:
            client = Client(address, timeout=HANDSHAKE_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise ClusterError(
                f"There is no scheduler at {address}: something listens there but does not "
                f"reply like a Dask scheduler of the same version ({reason}). Start one with "
                "`dask scheduler`; without --scheduler this machine is used."
            ) from error
    with client:
        yield Cluster(client, client.dashboard_link or "", local=False)


def _check_encryption(address: str) -> None:
    """Raise an error if an address does not match Dask's TLS configuration.

    Raises
    ------
    ClusterError
        If ``tls://`` lacks certificates, or encryption is required and the address has none.
    """
    required = dask.config.get("distributed.comm.require-encryption", False)
    if address.startswith("tls://"):
        try:
            context = Security().get_connection_args("client").get("ssl_context")
        except OSError as error:
            raise ClusterError(
                f"A certificate for {address} cannot be read: {error}. Check the paths in "
                "DASK_DISTRIBUTED__COMM__TLS__...; `palpate certs` creates certificates."
            ) from error
        if context is None:
            raise ClusterError(
                f"{address} is encrypted and needs certificates. Set the variables that `palpate "
                "certs` printed for this cluster, then run the same command again."
            )
    elif required:
        raise ClusterError(
            f"{address} is not encrypted, but DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION "
            "requires it. Give a tls:// address, or unset that variable."
        )


@contextmanager
def _unlogged(name: str) -> Iterator[None]:
    """Silence a library's own log of an error that is explained to the user."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


@contextmanager
def _local(workers: Workers | None, allowed_failures: int) -> Iterator[Cluster]:
    count = workers.least if isinstance(workers, WorkerRange) else workers or usable_cores()
    check_main_guard()
    with ExitStack() as stack:
        stack.enter_context(_restored_environment())
        os.environ.update(WORKER_ENVIRONMENT)  # inherited by the workers, before they load NumPy
        scratch = stack.enter_context(
            tempfile.TemporaryDirectory(prefix="palpate-dask-", ignore_cleanup_errors=True)
        )
        config = (
            CONFIG
            | SAFE_PATH_SETTING
            | {"distributed.scheduler.allowed-failures": allowed_failures}
        )
        stack.enter_context(dask.config.set(config))
        with unheard_interrupts(), warnings.catch_warnings():
            # Another process may take the port before Dask does; Dask then takes another, and
            # forgets to close the first socket.
            warnings.filterwarnings("ignore", message="\\s*Port .* is already in use")
            warnings.filterwarnings("ignore", message="unclosed <socket", category=ResourceWarning)
            cluster = stack.enter_context(
                _SteadyCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    protocol="tls://",  # other accounts of this machine reach the port
                    security=temporary_security(),
                    memory_limit=worker_memory(most_workers(workers or count)),
                    dashboard_address=f"127.0.0.1:{free_port(DASHBOARD_PORT)}",
                    local_directory=scratch,
                    silence_logs="CRITICAL",
                )
            )
        answer_to_own_hosts(cluster.scheduler)
        _require_workers(cluster)
        stack.enter_context(_mended(cluster))
        if isinstance(workers, WorkerRange):
            follow_the_work(cluster, workers)
        client = stack.enter_context(Client(cluster, set_as_default=False))
        yield Cluster(client, cluster.dashboard_link or "", local=True)


@contextmanager
def _restored_environment() -> Iterator[None]:
    """Restore the environment after Palpate and Dask have changed it for the workers."""
    before = {name: os.environ.get(name) for name in (*WORKER_ENVIRONMENT, SAFE_PATH)}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _require_workers(cluster: _SteadyCluster) -> None:
    """Restart workers if none has started; `_mended` replaces those that go missing later.

    Raises
    ------
    ClusterError
        If none starts.
    """
    for _ in range(START_ATTEMPTS - 1):
        if cluster.has_workers:
            return
        cluster.start_again()
    if not cluster.has_workers:
        raise ClusterError(
            f"No worker process has started in {START_ATTEMPTS} attempts: {cluster.failure}. "
            f"{_start_advice()}"
        )


def _start_advice() -> str:
    """Return advice for workers that do not start."""
    if lacks_guard():
        return (
            "Each worker imports the script that is running, which has no main guard: put the "
            'code that runs into a function, below the line `if __name__ == "__main__":`.'
        )
    return (
        "Look at the messages of the workers above. If there are none, free some memory or start "
        "fewer workers, then run the same command again."
    )


@contextmanager
def _mended(cluster: _SteadyCluster) -> Iterator[None]:
    """Replace workers that Dask has given up, for instance after a restart ran out of memory."""
    mending = PeriodicCallback(cluster.mend, 1000 * MEND_EVERY_S)
    cluster.loop.add_callback(mending.start)
    try:
        yield
    finally:
        cluster.loop.add_callback(mending.stop)


def worker_memory(workers: int) -> int:
    """Return the memory limit of each of several workers on this machine, in bytes."""
    return int(MEMORY_SHARE * MEMORY_LIMIT / workers)


def usable_cores() -> int:
    """Return the number of cores this process may use, fewer in a container or batch job."""
    return int(dask.system.CPU_COUNT)


def free_port(preferred: int) -> int:
    """Return `preferred` if nothing listens on that port, else 0: any free port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", preferred))
        except OSError:
            return 0
    return preferred
