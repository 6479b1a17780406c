"""Shares the workers of one cluster among jobs.

Jobs of higher priority come first. Among equals the next free slot goes to the owner who
holds the fewest, and of his jobs to the one that holds the fewest. What a job does not ask
for, because it waits for the last candidates of a generation, others use.
"""

import threading
from dataclasses import dataclass

from palpate.service.cluster.slots import slot_count


@dataclass(eq=False)
class JobSlots:
    """The slots of one job; see `service.cluster.slots.Slots`."""

    share: "FairShare"
    owner: str
    priority: int
    number: int
    held: int = 0
    hungry: bool = False

    def take(self, threads: int) -> bool:
        """See `Slots.take`."""
        return self.share.take(self, threads)

    def give_back(self) -> None:
        """See `Slots.give_back`."""
        self.share.give_back(self)

    def leave(self) -> None:
        """Give all back: the job runs no more."""
        self.share.leave(self)


class FairShare:
    """The slots of a cluster.

    Examples
    --------
    >>> share = FairShare()
    >>> first, second = share.join("ann", 0, 0), share.join("bob", 0, 1)
    >>> [first.take(1), first.take(1), second.take(1)]
    [True, True, False]
    >>> first.give_back()
    >>> [first.take(1), second.take(1)]
    [False, True]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: list[JobSlots] = []

    def join(self, owner: str, priority: int, number: int) -> JobSlots:
        """Return the slots of a job, which holds none yet."""
        job = JobSlots(self, owner, priority, number)
        with self._lock:
            self._jobs.append(job)
        return job

    def take(self, job: JobSlots, threads: int) -> bool:
        """Give a job a slot if there is one, and nobody comes first who has asked in vain."""
        with self._lock:
            room = sum(other.held for other in self._jobs) < slot_count(threads)
            first = min((o for o in self._jobs if o.hungry or o is job), key=self._rank)
            job.hungry = not (room and first is job)
            if not job.hungry:
                job.held += 1
            return not job.hungry

    def give_back(self, job: JobSlots) -> None:
        """Take a slot back."""
        with self._lock:
            job.held -= 1

    def leave(self, job: JobSlots) -> None:
        """Forget a job."""
        with self._lock:
            if job in self._jobs:
                self._jobs.remove(job)

    @property
    def held(self) -> int:
        """Return how many slots are taken."""
        with self._lock:
            return sum(job.held for job in self._jobs)

    def _rank(self, job: JobSlots) -> tuple[int, int, int, int]:
        of_owner = sum(other.held for other in self._jobs if other.owner == job.owner)
        return -job.priority, of_owner, job.held, job.number
