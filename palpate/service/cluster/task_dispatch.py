"""Dispatch of tasks to a cluster, or to this process, and again after a worker has died.

A future is released as soon as its ending has been processed: `Dispatcher.run` yields an
ending and releases the future when the next one is requested. Completed work is therefore
never repeated because another worker died.
Endings of a submission::

    finished                          returned, with the record of the task
    raised                            crashed, with the traceback of the worker
    the worker died too often         submitted again, `max_attempts` times in all, the last
                                      time alone; then lost
    forgotten by the scheduler        submitted again, any number of times

A store error (a full disk, another version) is unrelated to the candidate: it is
raised here and stops the study.

`Slots` limit the number of tasks that a dispatcher may have on the cluster at once.
`SingleProcess` is a dispatcher without a cluster: its tasks run one after the other.
"""

import queue
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, Protocol, TypeVar
from uuid import uuid4

from distributed import Client, Future, KilledWorker

from palpate.service.cluster.worker_failures import (
    as_cluster_error,
    death_reason,
    error_sentence,
    raise_if_foreign,
    raise_if_store,
    scheduler_gone,
)
from palpate.service.errors_and_interrupts import ClusterError, Interrupted, TaskError
from palpate.storage.errors import PalpateError, StoreError

TASKS_PER_THREAD = 2
"""One runs and one waits, so no worker idles while an ending is saved."""


class Slots(Protocol):
    """Slots for tasks; a task holds one from submission until its release."""

    def take(self, threads: int) -> bool:
        """Take a slot on a cluster with `threads` threads; return False if none is free."""

    def give_back(self) -> None:
        """Release one slot."""


class OwnSlots:
    """All slots of a cluster, for its only dispatcher.

    Examples
    --------
    >>> slots = OwnSlots()
    >>> [slots.take(threads=1) for _ in range(3)]
    [True, True, False]
    """

    def __init__(self) -> None:
        self._held = 0

    def take(self, threads: int) -> bool:
        """See `Slots.take`."""
        if self._held >= slot_count(threads):
            return False
        self._held += 1
        return True

    def give_back(self) -> None:
        """See `Slots.give_back`."""
        self._held -= 1


def slot_count(threads: int) -> int:
    """Return the number of slots of a cluster; positive even without workers."""
    return TASKS_PER_THREAD * max(1, threads)


Call = tuple[Any, tuple[Any, ...]]
"""A key, and the arguments of a task."""


class Later(Enum):
    """Marker for a call that has to wait until some task has ended."""

    NOT_YET = "not yet"


NOT_YET = Later.NOT_YET
TaskCalls = Iterable[Call | Literal[Later.NOT_YET]]
"""Calls, read only as fast as tasks end; `NOT_YET` is tried again after the next ending."""


def ready(calls: TaskCalls) -> Iterator[Call]:
    """Yield calls; one that is not ready is tried again at once."""
    for call in calls:
        if call is not NOT_YET:
            yield call


@dataclass
class Submission:
    """A task with the number of times it was sent."""

    key: Any
    arguments: tuple[Any, ...]
    attempts: int = 0
    future: Any = field(default=None, repr=False)


class WaitingCalls:
    """Calls that have not been sent; one is read ahead."""

    def __init__(self, calls: TaskCalls) -> None:
        self._calls: Iterator[Call | Literal[Later.NOT_YET]] = iter(calls)
        self._next = next(self._calls, None)

    def __bool__(self) -> bool:
        """Return True if there may be more calls."""
        return self._next is not None

    @property
    def ready(self) -> bool:
        """Return True if a call can be sent now."""
        if self._next is NOT_YET:
            self._next = next(self._calls, None)
        return self._next is not None and self._next is not NOT_YET

    def pop(self) -> Submission:
        """Return the next call."""
        first, self._next = self._next, next(self._calls, None)
        assert isinstance(first, tuple)
        return Submission(*first)


class Patience:
    """The times when a task last ended and when a worker was last present."""

    def __init__(self) -> None:
        self.ended = self.worked = time.monotonic()

    def restart(self) -> None:
        """Reset both times."""
        self.ended = self.worked = time.monotonic()


Task = Callable[..., Any]
"""A function that workers can import; its arguments and its record are small."""
Returned = TypeVar("Returned")

TICK_S = 0.25
TICK_FOR_SLOT_S = 0.05
COUNT_EVERY_S = 1.0


@dataclass(frozen=True)
class Ending:
    """The ending of a task.

    Parameters
    ----------
    key : hashable
        The key given to `Dispatcher.run`.
    kind : {"returned", "crashed", "lost"}
        See the module docstring.
    value : object
        The record that the task returned; None unless returned.
    error : Exception or None
        The exception raised by the task.
    reason : str
        Why there is no value; empty if there is one.
    traceback : str
        Traceback on the worker; empty unless crashed.
    attempts : int
        Number of submissions.
    """

    key: Any
    kind: Literal["returned", "crashed", "lost"]
    value: Any = None
    error: BaseException | None = None
    reason: str = ""
    traceback: str = ""
    attempts: int = 1


class TaskRunner(Protocol):
    """A runner of tasks: a `Dispatcher`, or this process; see `service.cluster.task_dispatch`."""

    @property
    def threads(self) -> int:
        """Return the number of tasks that can run at once."""

    def call(self, task: Callable[..., Returned], *arguments: Any) -> Returned:
        """See `Dispatcher.call`."""

    def all(self, task: Callable[..., Returned], calls: TaskCalls) -> list[Returned]:
        """See `Dispatcher.all`."""

    def everywhere(self, task: Callable[..., Returned], *arguments: Any) -> dict[str, Returned]:
        """See `Dispatcher.everywhere`."""

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """See `Dispatcher.run`."""


_Arrived = queue.SimpleQueue[Submission]


class Dispatcher:
    """A dispatcher that bounds the tasks in flight and sets a deadline for every wait.

    Parameters
    ----------
    client : distributed.Client
        A client connected to the scheduler.
    max_attempts : int
        Number of submissions of a task whose workers die, before it is lost. (The
        scheduler itself retries, too; see `service.cluster.dask_cluster`.)
    no_worker_s : float
        Longest wait without any worker.
    no_ending_s : float
        Longest wait without an ending while there are workers.
    stop : callable
        Called between waits; True ends the run with `Interrupted`.
    slots : Slots, optional
        The number of tasks it may have on the cluster; by default all of the cluster.
    priority : int
        Priority of its tasks in the queue; higher ones run first.
    """

    def __init__(
        self,
        client: Client,
        *,
        max_attempts: int = 5,
        no_worker_s: float = 120.0,
        no_ending_s: float = 4 * 3600.0,
        stop: Callable[[], bool] = lambda: False,
        slots: Slots | None = None,
        priority: int = 0,
    ) -> None:
        self.client = client
        self.slots = slots or OwnSlots()
        self.priority = priority
        self.max_attempts = max_attempts
        self.no_worker_s = no_worker_s
        self.no_ending_s = no_ending_s
        self.stop = stop
        self._threads = 0
        self._counted = -COUNT_EVERY_S

    @property
    def threads(self) -> int:
        """Return the number of tasks that can run at once, updated every `COUNT_EVERY_S`."""
        now = time.monotonic()
        if now - self._counted >= COUNT_EVERY_S:
            self._threads = sum(self._threads_by_worker().values())
            self._counted = now
        return self._threads

    def call(self, task: Callable[..., Returned], *arguments: Any) -> Returned:
        """Run one task and return its record.

        Raises
        ------
        PalpateError
            If raised by the task; `TaskError` for any other exception.
        ClusterError
            If its workers die repeatedly, or there are none.
        Interrupted
            If the study is stopped.
        """
        (record,) = self.all(task, [(task.__name__, arguments)])
        return record

    def all(self, task: Callable[..., Returned], calls: TaskCalls) -> list[Returned]:
        """Run tasks that must not fail and return their records in order of arrival.

        Raises
        ------
        PalpateError, ClusterError, Interrupted
            As for `call`.
        """
        return [value_of(ending, task.__name__) for ending in self.run(task, calls)]

    def everywhere(self, task: Callable[..., Returned], *arguments: Any) -> dict[str, Returned]:
        """Run one task on each current worker and return the records by worker address."""
        found: dict[str, Returned] = self.client.run(task, *arguments)
        return found

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Send tasks and yield their endings as they arrive.

        Parameters
        ----------
        task : callable
            Importable by the workers; its arguments and its record are small.
        calls : iterable of (key, arguments)
            Read only as fast as tasks end. `NOT_YET` marks a call that has to wait for an
            ending; another task must be running then.

        Raises
        ------
        ClusterError
            If a wait passes its deadline, or the scheduler is gone.
        StoreError
            If a worker cannot use the store.
        Interrupted
            If the study is stopped.
        """
        arrived: _Arrived = queue.SimpleQueue()
        waiting, patience = WaitingCalls(calls), Patience()
        in_flight: dict[int, Submission] = {}
        suspects: list[Submission] = []  # have one attempt left, and run alone
        try:
            while True:
                for submission in self._to_send(waiting, suspects, in_flight):
                    in_flight[id(submission)] = submission
                    self._send(task, submission, arrived)
                if not (in_flight or waiting or suspects):
                    return
                arrival = self._wait(arrived, patience, waiting.ready, bool(in_flight))
                if arrival is None:
                    continue
                ending = self._ending(arrival)
                if ending is not None:
                    yield ending
                    # The caller has saved this ending before requesting the next one.
                    self._leave(in_flight, arrival)
                    continue
                self._release(arrival)
                if arrival.attempts < self.max_attempts - 1:
                    self._send(task, arrival, arrived)
                else:
                    self._leave(in_flight, arrival)
                    suspects.append(arrival)
        finally:
            for submission in list(in_flight.values()):
                self._leave(in_flight, submission)

    def _to_send(
        self, waiting: WaitingCalls, suspects: list[Submission], in_flight: dict[int, Submission]
    ) -> Iterator[Submission]:
        """Yield the submissions that can be sent now; those that kill workers go last and alone.

        If a worker dies, the task queued behind another one on it is submitted again.
        """
        while waiting.ready and self.slots.take(self.threads):
            yield waiting.pop()
        if suspects and not (waiting.ready or in_flight) and self.slots.take(self.threads):
            yield suspects.pop()

    def _leave(self, in_flight: dict[int, Submission], submission: Submission) -> None:
        del in_flight[id(submission)]
        self.slots.give_back()
        self._release(submission)

    def _send(self, task: Task, submission: Submission, arrived: _Arrived) -> None:
        submission.attempts += 1
        # The key is always new: Dask remembers the outcome of a key for a while.
        key = f"{task.__name__}-{uuid4().hex}"
        with as_cluster_error():
            submission.future = self.client.submit(
                task, *submission.arguments, key=key, pure=False, priority=self.priority
            )
        submission.future.add_done_callback(lambda _: arrived.put(submission))

    def _release(self, submission: Submission) -> None:
        """Make the scheduler forget a task; one that has not started will not start."""
        if submission.future is not None:
            with suppress(Exception):
                submission.future.release()
            submission.future = None

    def _wait(
        self, arrived: _Arrived, patience: Patience, waiting: bool, in_flight: bool
    ) -> Submission | None:
        """Return the next arrival; None after a moment, since a slot may have become free."""
        if self.stop():
            raise Interrupted
        with suppress(queue.Empty):
            arrival = arrived.get(timeout=TICK_FOR_SLOT_S if waiting else TICK_S)
            patience.restart()
            return arrival
        now = time.monotonic()
        if self.threads:
            patience.worked = now
        if not in_flight:
            patience.ended = now  # other dispatchers have all the slots
        self._check_deadlines(now - patience.ended, now - patience.worked)
        return None

    def _check_deadlines(self, waited_s: float, without_worker_s: float) -> None:
        if without_worker_s > self.no_worker_s:
            address = self.client.scheduler.address if self.client.scheduler else "ADDRESS"
            raise ClusterError(
                f"There has been no worker at {address} for {without_worker_s:.0f} s. Start one "
                f"with `dask worker {address} --nthreads 1`, or use the workers of this machine. "
                "Completed work is kept: run the same command again to continue."
            )
        if waited_s > self.no_ending_s:
            raise ClusterError(
                f"There are {self._threads} workers, but no task has ended for "
                f"{waited_s:.0f} s. Check the dashboard, restart the workers, and run the "
                "same command again to continue."
            )

    def _threads_by_worker(self) -> dict[str, int]:
        with as_cluster_error():
            if self.client.status == "connecting":
                return {}
            if self.client.status != "running":
                raise OSError(f"the connection is {self.client.status}")
            return dict(self.client.nthreads())

    def _ending(self, submission: Submission) -> Ending | None:
        """Return the ending of a task that has arrived; None if it must be submitted again."""
        future: Future = submission.future
        if future is None or future.status in ("cancelled", "lost"):
            # The scheduler was restarted or the connection broke; this is not the task's fault.
            submission.attempts -= 1
            self._outlast_disconnection()
            return None
        try:
            value = future.result(timeout=60.0)
        except KilledWorker as killed:
            if submission.attempts < self.max_attempts:
                return None
            return Ending(
                submission.key, "lost", reason=death_reason(killed), attempts=submission.attempts
            )
        except Exception as caught:
            error = caught
        else:
            return Ending(submission.key, "returned", value, attempts=submission.attempts)
        if future.status != "error":
            # The result was on a worker that is gone: submit again, it is in the store.
            if submission.attempts < self.max_attempts:
                return None
            return Ending(
                submission.key, "lost", reason=error_sentence(error), attempts=submission.attempts
            )
        raise_if_store(error)
        raise_if_foreign(error)
        trace = future.traceback(timeout=60.0)  # on the worker, without frames of this process
        text = "".join(traceback.format_exception(type(error), error, trace))
        return Ending(
            submission.key, "crashed", None, error, error_sentence(error), text, submission.attempts
        )

    def _outlast_disconnection(self) -> None:
        begun = time.monotonic()
        while self.client.status == "connecting":
            if self.stop():
                raise Interrupted
            if time.monotonic() - begun > self.no_worker_s:
                break
            time.sleep(TICK_S)
        if self.client.status != "running":
            raise scheduler_gone(f"the connection is {self.client.status}")


def value_of(ending: Ending, what: str) -> Any:
    """Return the record of a task that must not fail.

    Parameters
    ----------
    ending : Ending
    what : str
        Name of the task in messages.

    Raises
    ------
    PalpateError
        If raised by the task.
    ClusterError
        If the task was lost.
    TaskError
        If the task raised any other exception; the message has the worker's traceback.
    """
    if ending.kind == "returned":
        return ending.value
    if isinstance(ending.error, PalpateError):
        raise ending.error
    if ending.kind == "lost":
        raise ClusterError(
            f"{what} was lost: {ending.reason}. Give the workers more memory, or start fewer with "
            "--workers, and run the same command again: completed work is kept."
        )
    raise TaskError(
        f"{what} failed: {ending.reason}.\n{ending.traceback}".rstrip()
    ) from ending.error


class SingleProcess:
    """A `service.cluster.task_dispatch.TaskRunner` that runs tasks in this process, in order."""

    @property
    def threads(self) -> int:
        """Return the number of tasks that run at once."""
        return 1

    def call(self, task: Callable[..., Returned], *arguments: object) -> Returned:
        """Run one task; its exceptions are passed on unchanged."""
        return task(*arguments)

    def all(self, task: Callable[..., Returned], calls: TaskCalls) -> list[Returned]:
        """Run tasks that must not fail."""
        return [task(*arguments) for _, arguments in ready(calls)]

    def everywhere(self, task: Callable[..., Returned], *arguments: object) -> dict[str, Returned]:
        """Run one task in this process, the only one."""
        return {"this process": task(*arguments)}

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks that may fail: an exception is a crash, unless it is a store error."""
        for key, arguments in ready(calls):
            try:
                yield Ending(key, "returned", task(*arguments))
            except StoreError:
                raise
            except Exception as error:
                reason = f"{type(error).__name__}: {error}"
                yield Ending(
                    key, "crashed", error=error, reason=reason, traceback=traceback.format_exc()
                )
