"""Adaptive scaling: the number of workers of a cluster follows the work.

One worker is wanted for each task on the cluster. A dispatcher sends two tasks for each worker
(`cluster.slots`), so the number of workers doubles until the maximum is reached or the work
runs out. Only workers idle for `IDLE_S` are retired, so the end of a generation, when few
candidates are left, does not cost workers that the next generation needs.

Dask's own estimate uses the seconds of work in the queue, which are always few here.
"""

from collections import deque
from typing import Any

from distributed.deploy import Adaptive

from palpate.service.cluster.worker_range import WorkerRange

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
