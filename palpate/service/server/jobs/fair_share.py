"""Fair sharing of one cluster's workers among jobs.

Jobs of higher priority come first. Among equals the next free slot goes to the owner who holds the
fewest slots, and to that owner's job with the fewest. Slots that a job does not need while it waits
for the last candidates of a generation go to others.
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
        """Return all slots; the job has stopped."""
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
        """Return the slots of a new job, none of them taken."""
        job = JobSlots(self, owner, priority, number)
        with self._lock:
            self._jobs.append(job)
        return job

    def take(self, job: JobSlots, threads: int) -> bool:
        """Give a job a slot if one is free and no waiting job has precedence."""
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
        """Remove a job."""
        with self._lock:
            if job in self._jobs:
                self._jobs.remove(job)

    @property
    def held(self) -> int:
        """Return the number of taken slots."""
        with self._lock:
            return sum(job.held for job in self._jobs)

    def _rank(self, job: JobSlots) -> tuple[int, int, int, int]:
        of_owner = sum(other.held for other in self._jobs if other.owner == job.owner)
        return -job.priority, of_owner, job.held, job.number
