"""A service as a whole: its home, queue, runner, uploads, tokens, limits and the cluster's load.

The load of the workers is queried at most once a second, however many requests ask for it.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.service.cluster.dask_cluster import Cluster
from palpate.service.server.api_models import WorkerView
from palpate.service.server.job_progress import ProgressBook
from palpate.service.server.jobs.home_and_tokens import ServiceHome, Tokens, take_token
from palpate.service.server.jobs.job_queue import Queue
from palpate.service.server.jobs.job_runner import OpenCluster, Runner
from palpate.service.server.jobs.untrusted_inputs import Limits, Uploads
from palpate.service.server.live_bodies import BodiesMaker
from palpate.service.study.task_requests import Tasks
from palpate.storage.backends.store_paths import Location, place_of
from palpate.storage.store import Store, open_store

ASK_EVERY_S = 1.0


class ClusterLoad:
    """The workers of a cluster, shared by concurrent requests.

    Parameters
    ----------
    cluster : callable
        Returns the cluster, or None while there is none.
    """

    def __init__(self, cluster: Callable[[], Cluster | None]) -> None:
        self._cluster = cluster
        self._lock = threading.Lock()
        self._known: list[WorkerView] = []
        self._asked = -ASK_EVERY_S

    def workers(self) -> list[WorkerView]:
        """Return the workers by name, or the last known ones if the scheduler does not answer."""
        with self._lock:
            if time.monotonic() - self._asked >= ASK_EVERY_S:
                self._known = self._ask()
                self._asked = time.monotonic()
            return self._known

    def _ask(self) -> list[WorkerView]:
        cluster = self._cluster()
        if cluster is None or cluster.client.status != "running":
            return []
        try:
            known = cluster.client.scheduler_info(n_workers=-1)["workers"]
        except Exception:  # it is shutting down
            return []
        views = [_worker_view(address, worker) for address, worker in known.items()]
        return sorted(views, key=lambda view: (len(view.name), view.name))


def _worker_view(address: str, worker: Mapping[str, Any]) -> WorkerView:
    metrics = worker.get("metrics") or {}
    tasks = metrics.get("task_counts") or {}
    return WorkerView(
        name=str(worker.get("name", address)),
        address=address,
        threads=worker.get("nthreads", 0),
        running=tasks.get("executing", 0),
        waiting=tasks.get("ready", 0),
        cpu_percent=metrics.get("cpu", 0.0),
        memory_bytes=metrics.get("memory", 0),
        memory_limit_bytes=worker.get("memory_limit") or 0,
    )


@dataclass(frozen=True, eq=False)
class Service:
    """All parts of a service.

    Parameters
    ----------
    read_token : bool
        Whether reading needs a token as well.
    """

    home: ServiceHome
    store: Store
    queue: Queue
    runner: Runner
    uploads: Uploads
    tokens: Tokens
    progress: ProgressBook
    limits: Limits
    read_token: bool
    bodies: BodiesMaker
    load: ClusterLoad


@contextmanager
def open_service(
    root: Path,
    open_cluster: OpenCluster,
    *,
    store: Location | None = None,
    limits: Limits | None = None,
    read_token: bool = False,
    tasks: Tasks | None = None,
    at_once: int = 8,
    reports: bool = True,
) -> Iterator[Service]:
    """Open the service in a folder and run its waiting jobs until it is closed.

    Parameters
    ----------
    root : Path
        Created if missing.
    open_cluster : callable
        Opens the cluster.
    store : str or Path, optional
        Default: the folder ``store`` in `root`.
    tasks : Tasks, optional
        Functions sent to the workers.
    at_once : int
        Number of jobs run at the same time.
    reports : bool
        Write the page of a completed study.

    Raises
    ------
    StoreError
        If folder or store cannot be used, or another service is using them.
    """
    given = take_token()  # before any process inherits it
    limits, root = limits or Limits(), root.expanduser().absolute()
    home = ServiceHome(root, place_of(store or root / "store"))
    home.make()
    opened = open_store(home.store)
    queue = Queue(home.queue)
    try:
        uploads = Uploads(home.uploads, limits)
        runner = Runner(
            home, queue, uploads, open_cluster, tasks=tasks, at_once=at_once, reports=reports
        )
        tokens, bodies = Tokens(home.tokens, given), BodiesMaker()
        runner.start()
        try:
            yield Service(
                home,
                opened,
                queue,
                runner,
                uploads,
                tokens,
                ProgressBook(),
                limits,
                read_token,
                bodies,
                ClusterLoad(lambda: runner.cluster),
            )
        finally:
            bodies.close()
            runner.stop()
    finally:
        queue.close()
