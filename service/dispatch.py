"""Sends tasks to a Dask cluster and gives back their endings.

A future is released as soon as its ending has been dealt with: `Dispatcher.run`
yields an ending and releases the future when it is asked for the next one. What
a worker finished is then never run again because some other worker died.

How a submission ends::

    finished                          returned, with the record of the task
    raised                            crashed, with the traceback of the worker
    the worker died, once too often   submitted again, `max_attempts` times in all, at last
                                      alone; then lost
    the scheduler forgot it           submitted again, as often as it takes

An error of the store (a full disk, another version) is no verdict on a candidate:
it is raised here and stops the study.
"""

import errno
import queue
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar
from uuid import uuid4

from distributed import Client, Future, KilledWorker

from service.errors import ClusterError, Interrupted, TaskError
from storage.errors import PalpateError, StoreError

Task = Callable[..., Any]
"""A function that workers can import: small arguments, a small record back."""
TaskCalls = Iterable[tuple[Any, tuple[Any, ...]]]
"""Keys, and the arguments of a task for each."""
Returned = TypeVar("Returned")

TICK_S = 0.25
COUNT_EVERY_S = 1.0
FULL_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}


@dataclass(frozen=True)
class Ending:
    """How a task ended.

    Parameters
    ----------
    key : hashable
        As given to `Dispatcher.run`.
    kind : {"returned", "crashed", "lost"}
        See the top of this file.
    value : object
        The record that the task returned; None unless returned.
    error : Exception or None
        What it raised.
    reason : str
        Why there is no value; empty if there is one.
    traceback : str
        On the worker; empty unless crashed.
    attempts : int
        How often it was submitted.
    """

    key: Any
    kind: Literal["returned", "crashed", "lost"]
    value: Any = None
    error: BaseException | None = None
    reason: str = ""
    traceback: str = ""
    attempts: int = 1


@dataclass
class _Submission:
    key: Any
    arguments: tuple[Any, ...]
    attempts: int = 0
    future: Any = field(default=None, repr=False)


_Arrived = queue.SimpleQueue[_Submission]


class Dispatcher:
    """A bounded number of tasks in flight, and a deadline on every wait.

    Parameters
    ----------
    client : distributed.Client
        Connected to the scheduler.
    max_attempts : int
        How often a task is submitted whose workers die, before it is lost. (The
        scheduler itself already tries again; see `service.cluster`.)
    no_worker_s : float
        How long to wait while there is no worker.
    no_ending_s : float
        How long to wait while there are workers but no task ends.
    stop : callable
        Called between waits; True ends the run with `Interrupted`.
    """

    def __init__(
        self,
        client: Client,
        *,
        max_attempts: int = 5,
        no_worker_s: float = 120.0,
        no_ending_s: float = 4 * 3600.0,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.client = client
        self.max_attempts = max_attempts
        self.no_worker_s = no_worker_s
        self.no_ending_s = no_ending_s
        self.stop = stop
        self._threads = 0
        self._counted = -COUNT_EVERY_S

    @property
    def threads(self) -> int:
        """Return how many tasks can run at once, counted anew every `COUNT_EVERY_S`."""
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
            As the task raised it; `TaskError` for any other exception.
        ClusterError
            If its workers die again and again, or there are none.
        Interrupted
            If the study is told to stop.
        """
        (record,) = self.all(task, [(task.__name__, arguments)])
        return record

    def all(self, task: Callable[..., Returned], calls: TaskCalls) -> list[Returned]:
        """Run tasks that must not fail and return their records in order of arrival.

        Raises
        ------
        PalpateError, ClusterError, Interrupted
            As `call`.
        """
        return [value_of(ending, task.__name__) for ending in self.run(task, calls)]

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Send tasks, yield their endings as they arrive.

        Parameters
        ----------
        task : callable
            Importable by the workers; small arguments, a small record back.
        calls : iterable of (key, arguments)
            Read only as fast as tasks end.

        Raises
        ------
        ClusterError
            If a wait passes its deadline, or the scheduler is gone.
        StoreError
            If a worker cannot use the store.
        Interrupted
            If the study is told to stop.
        """
        arrived: _Arrived = queue.SimpleQueue()
        waiting = (_Submission(key, arguments) for key, arguments in calls)
        in_flight: dict[int, _Submission] = {}
        suspects: list[_Submission] = []  # have one attempt left, and nothing else runs meanwhile
        try:
            while True:
                for submission in self._to_send(waiting, suspects, in_flight):
                    in_flight[id(submission)] = submission
                    self._send(task, submission, arrived)
                if not in_flight:
                    return
                submission = self._wait(arrived)
                ending = self._ending(submission)
                if ending is not None:
                    yield ending
                    # Whoever asks for the next ending has written this one down.
                    del in_flight[id(submission)]
                    self._release(submission)
                    continue
                self._release(submission)
                if submission.attempts < self.max_attempts - 1:
                    self._send(task, submission, arrived)
                else:
                    suspects.append(in_flight.pop(id(submission)))
        finally:
            for submission in in_flight.values():
                self._release(submission)

    def _to_send(
        self,
        waiting: Iterator[_Submission],
        suspects: list[_Submission],
        in_flight: dict[int, _Submission],
    ) -> Iterator[_Submission]:
        """Yield what can be sent now; whatever kills its workers goes last and alone.

        One task runs and one waits for each thread, so that no worker idles while an ending
        is journalled. If a worker dies, the one that waited is submitted again.
        """
        while len(in_flight) < 2 * max(1, self.threads):
            submission = next(waiting, None)
            if submission is None:
                break
            yield submission
        if not in_flight and suspects:
            yield suspects.pop()

    @contextmanager
    def meanwhile(self, task: Task, calls: TaskCalls) -> Iterator[None]:
        """Run tasks beside others; nobody waits for them or learns how they end."""
        sent = [_Submission(key, arguments) for key, arguments in calls]
        try:
            for submission in sent:
                self._send(task, submission, queue.SimpleQueue())
            yield
        finally:
            for submission in sent:
                self._release(submission)

    def _send(self, task: Task, submission: _Submission, arrived: _Arrived) -> None:
        submission.attempts += 1
        # The key is new every time: Dask remembers the end of a key for a while.
        key = f"{task.__name__}-{uuid4().hex}"
        with _as_cluster_error():
            submission.future = self.client.submit(task, *submission.arguments, key=key, pure=False)
        submission.future.add_done_callback(lambda _: arrived.put(submission))

    def _release(self, submission: _Submission) -> None:
        """Let the scheduler forget a task; one that has not started will not start."""
        if submission.future is not None:
            with suppress(Exception):
                submission.future.release()
            submission.future = None

    def _wait(self, arrived: _Arrived) -> _Submission:
        begun = alive = time.monotonic()
        while not self.stop():
            with suppress(queue.Empty):
                return arrived.get(timeout=TICK_S)
            now = time.monotonic()
            if self.threads:
                alive = now
            self._check_deadlines(now - begun, now - alive)
        raise Interrupted

    def _check_deadlines(self, waited_s: float, without_worker_s: float) -> None:
        if without_worker_s > self.no_worker_s:
            address = self.client.scheduler.address if self.client.scheduler else "ADDRESS"
            raise ClusterError(
                f"There has been no worker for {without_worker_s:.0f} s. Start one with "
                f"`dask worker {address} --nthreads 1`, or let `palpate run` start its own by "
                "leaving out --scheduler. What is journalled is kept: run the study again to "
                "continue."
            )
        if waited_s > self.no_ending_s:
            raise ClusterError(
                f"There are {self._threads} workers, but no task has ended for "
                f"{waited_s:.0f} s. Look at the dashboard, restart the workers, and run the "
                "study again to continue."
            )

    def _threads_by_worker(self) -> dict[str, int]:
        with _as_cluster_error():
            if self.client.status == "connecting":
                return {}
            if self.client.status != "running":
                raise OSError(f"the connection is {self.client.status}")
            return dict(self.client.nthreads())

    def _ending(self, submission: _Submission) -> Ending | None:
        """Return the ending of a task that has arrived; None if it is to be submitted again."""
        future: Future = submission.future
        if future is None or future.status in ("cancelled", "lost"):
            # The scheduler was restarted or the connection broke; no worker is to blame.
            submission.attempts -= 1
            self._outlast_disconnection()
            return None
        try:
            value = future.result(timeout=60.0)
        except KilledWorker as killed:
            if submission.attempts < self.max_attempts:
                return None
            return Ending(
                submission.key, "lost", reason=_death(killed), attempts=submission.attempts
            )
        except Exception as caught:
            error = caught
        else:
            return Ending(submission.key, "returned", value, attempts=submission.attempts)
        if future.status != "error":
            # The result was on a worker that is gone: submit again, the store has it.
            if submission.attempts < self.max_attempts:
                return None
            return Ending(
                submission.key, "lost", reason=_sentence(error), attempts=submission.attempts
            )
        _raise_if_store(error)
        trace = future.traceback(timeout=60.0)  # of the worker, without our own frames
        text = "".join(traceback.format_exception(type(error), error, trace))
        return Ending(
            submission.key, "crashed", None, error, _sentence(error), text, submission.attempts
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
            raise _scheduler_gone(f"the connection is {self.client.status}")


def value_of(ending: Ending, what: str) -> Any:
    """Return the record of a task that must not fail.

    Parameters
    ----------
    ending : Ending
    what : str
        The task as a message calls it.

    Raises
    ------
    PalpateError
        As the task raised it.
    ClusterError
        If the task was lost.
    TaskError
        If it raised anything else; with the traceback of the worker.
    """
    if ending.kind == "returned":
        return ending.value
    if isinstance(ending.error, PalpateError):
        raise ending.error
    if ending.kind == "lost":
        raise ClusterError(
            f"{what} was lost: {ending.reason}. Give the workers more memory, or start fewer with "
            "--workers, and run the same command again: what is finished is kept."
        )
    raise TaskError(
        f"{what} failed: {ending.reason}.\n{ending.traceback}".rstrip()
    ) from ending.error


class _as_cluster_error:  # noqa: N801 - a context manager
    """Say in words what Dask raises when the scheduler has gone."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError | TimeoutError | RuntimeError):
            raise _scheduler_gone(_sentence(error)) from error


def _scheduler_gone(what: str) -> ClusterError:
    return ClusterError(
        f"The scheduler cannot be reached any more: {what}. What is journalled is kept: run the "
        "study again to continue."
    )


def _raise_if_store(error: BaseException) -> None:
    if isinstance(error, StoreError):
        raise error
    if isinstance(error, OSError) and error.errno in FULL_DISK:
        raise StoreError(
            f"A worker cannot write to the store: {error}. Free some space, then run the study "
            "again to continue."
        ) from error


def _lost(submission: _Submission, reason: str) -> Ending:
    return Ending(submission.key, "lost", reason=reason, attempts=submission.attempts)


def _death(killed: KilledWorker) -> str:
    worker = getattr(killed, "last_worker", None)
    name = getattr(worker, "address", None) or "unknown"
    deaths = killed.allowed_failures + 1 if hasattr(killed, "allowed_failures") else "several"
    return f"its worker died every time, {deaths} deaths in the last attempt; last worker {name}"


def _sentence(error: BaseException) -> str:
    text = str(error).strip() or "no message"
    return f"{type(error).__name__}: {text}"
