"""The load of a cluster's workers, queried at most once a second."""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from palpate.service.cluster.open import Cluster
from palpate.service.server.api import WorkerView

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
        views = [_view(address, worker) for address, worker in known.items()]
        return sorted(views, key=lambda view: (len(view.name), view.name))


def _view(address: str, worker: Mapping[str, Any]) -> WorkerView:
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
