"""Lets the number of workers of a cluster follow the work.

A worker is wanted for each task on the cluster. A dispatcher sends two for each worker
(`cluster.slots`), so while there is more to do their number doubles until the most is reached.
Workers that have not been wanted for `IDLE_S` are retired, idle ones only: the end of a
generation, when few candidates are left, does not cost workers that the next one needs.

Dask's own estimate goes by the seconds of work that are waiting, which here are never many.
"""

from collections import deque
from typing import Any

from distributed.deploy import Adaptive

from palpate.service.cluster.worker_range import WorkerRange

ADAPT_EVERY_S = 1.0
IDLE_S = 60.0


class FollowTheWork(Adaptive):
    """Scales a cluster whose scheduler runs in this process; see the top of this file.

    Parameters
    ----------
    *arguments, **options
        As Dask's own takes them; of them ``wait_count`` says for how many checks a worker must
        not have been wanted.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._targets: deque[int] = deque(maxlen=self.wait_count)

    async def target(self) -> int:
        """Return how many tasks run or wait for a worker."""
        scheduler = self.cluster.scheduler
        on_workers = sum(len(worker.processing) for worker in scheduler.workers.values())
        return on_workers + len(scheduler.queued) + len(scheduler.unrunnable)

    async def recommendations(self, target: int) -> dict[str, Any]:
        """Return what is to be done, as Dask's own says it.

        Parameters
        ----------
        target : int
            Workers that are wanted now, within the bounds.
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
    """Let a cluster of Dask grow and shrink within a range, until it is closed."""
    cluster.adapt(
        Adaptive=FollowTheWork,
        minimum=workers.least,
        maximum=workers.most,
        interval=ADAPT_EVERY_S,
        wait_count=max(1, round(IDLE_S / ADAPT_EVERY_S)),
    )
