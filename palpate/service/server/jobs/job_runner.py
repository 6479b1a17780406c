"""Runner of queued jobs on one cluster, several at once, which share its workers fairly.

Each waiting job runs in a thread of its own; the fair share limits its tasks on the cluster.
If the cluster is lost, it is opened again and the jobs continue.

Jobs of higher priority come first. Among equals the next free slot goes to the owner who holds the
fewest slots, and to that owner's job with the fewest. Slots that a job does not need while it waits
for the last candidates of a generation go to others.
"""

import logging
import math
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from palpate.service.cluster.dask_cluster import Cluster
from palpate.service.cluster.task_dispatch import Dispatcher, slot_count
from palpate.service.cluster.worker_failures import prepare_workers
from palpate.service.errors_and_interrupts import ClusterError, Interrupted
from palpate.service.server.jobs.home_and_tokens import ServiceHome, inside
from palpate.service.server.jobs.job_queue import Job, Queue, StateError
from palpate.service.server.jobs.study_and_diagnosis_jobs import (
    ReportError,
    run_queued_diagnosis,
    run_queued_study,
)
from palpate.service.server.jobs.untrusted_inputs import Uploads
from palpate.service.study.study_session import DaskRecords, Session
from palpate.service.study.task_requests import Tasks
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError, PalpateError


@dataclass(eq=False)
class JobSlots:
    """The slots of one job; see `service.cluster.task_dispatch.Slots`."""

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


_log = logging.getLogger(__name__)

TICK_S = 0.1
REOPEN_S = 3.0
MOST_FAILURES = 3  # consecutive failures of the cluster while a job makes no progress
STOP_S = 30.0

OpenCluster = Callable[[], AbstractContextManager[Cluster]]


@dataclass
class _Active:
    """A running job."""

    thread: threading.Thread
    stop: threading.Event = field(default_factory=threading.Event)


@dataclass
class _Setback:
    """Number of times that a job has lost the cluster since its journal last grew."""

    size: int = -1
    count: int = 0
    not_before: float = 0.0
    note: str = ""


class Runner:
    """Runner of the waiting jobs of a queue.

    Parameters
    ----------
    home : ServiceHome
    queue : Queue
    uploads : Uploads
    open_cluster : callable
        Opens the cluster; called again if it is lost.
    tasks : Tasks, optional
        Functions sent to the workers.
    at_once : int
        Number of jobs run at the same time.
    reports : bool
        Write the page of a completed study.
    """

    def __init__(
        self,
        home: ServiceHome,
        queue: Queue,
        uploads: Uploads,
        open_cluster: OpenCluster,
        *,
        tasks: Tasks | None = None,
        at_once: int = 8,
        reports: bool = True,
    ) -> None:
        self.home, self.queue, self.uploads = home, queue, uploads
        self._open_cluster, self._tasks = open_cluster, tasks
        self._at_once, self._reports = at_once, reports
        self.share = FairShare()
        self.cluster: Cluster | None = None
        self.trouble = "the cluster is starting"
        self._active: dict[str, _Active] = {}
        self._setbacks: dict[str, _Setback] = {}
        self._stopping = threading.Event()
        self._cluster_lost = threading.Event()
        self._thread = threading.Thread(target=self._run, name="runner")

    def start(self) -> None:
        """Start running waiting jobs."""
        self._thread.start()

    def stop(self) -> None:
        """Stop all jobs, which continue when the service restarts, and close the cluster."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(STOP_S + 30.0)

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called."""
        return self._stopping.is_set()

    def is_running(self, identifier: str) -> bool:
        """Check whether a job is running."""
        return identifier in self._active

    def note(self, identifier: str) -> str:
        """Return the reason why a waiting job does not run; empty if unknown."""
        setback = self._setbacks.get(identifier)
        if setback or self.cluster is None:
            return setback.note if setback else self.trouble
        return "" if self.threads else "the cluster has no workers"

    @property
    def threads(self) -> int:
        """Return the number of tasks the cluster can run at once; 0 without a cluster."""
        cluster = self.cluster
        if cluster is None or cluster.client.status != "running":
            return 0
        try:
            return sum(dict(cluster.client.nthreads()).values())
        except Exception:
            return 0

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                with self._open_cluster() as cluster:
                    self._cluster_lost.clear()
                    self.cluster, self.trouble = cluster, ""
                    try:
                        self._run_jobs(cluster)
                    finally:
                        self.cluster = None
                        self._end_all()
            except ClusterError as error:
                self.trouble = str(error)
            except Exception as error:
                _log.exception("The cluster has failed and is being reopened.")
                self.trouble = f"The cluster has failed: {type(error).__name__}: {error}"
            self._stopping.wait(REOPEN_S)

    def _run_jobs(self, cluster: Cluster) -> None:
        while not self._stopping.is_set() and not self._cluster_lost.is_set():
            for identifier, active in list(self._active.items()):
                job = self.queue.get(identifier)
                if job is None or job.state != "waiting":
                    active.stop.set()
                if not active.thread.is_alive():
                    del self._active[identifier]
            for job in self._startable():
                self._start(job, cluster)
            self._stopping.wait(TICK_S)

    def _startable(self) -> list[Job]:
        now = time.monotonic()
        waiting = [
            job
            for job in self.queue.jobs
            if job.state == "waiting"
            and job.id not in self._active
            and self._setbacks.get(job.id, _Setback()).not_before <= now
        ]
        waiting.sort(key=lambda job: (-job.priority, job.number))
        return waiting[: max(0, self._at_once - len(self._active))]

    def _start(self, job: Job, cluster: Cluster) -> None:
        active = _Active(threading.Thread())
        active.thread = threading.Thread(
            target=self._run_job, args=(job, cluster, active.stop), name=f"job {job.id}"
        )
        self._active[job.id] = active
        active.thread.start()

    def _end_all(self) -> None:
        for active in self._active.values():
            active.stop.set()
        until = time.monotonic() + STOP_S
        for active in self._active.values():
            active.thread.join(max(0.0, until - time.monotonic()))
        self._active.clear()

    def _run_job(self, job: Job, cluster: Cluster, stop: threading.Event) -> None:
        slots = self.share.join(job.owner, job.priority, job.number)
        try:
            prepare_workers(cluster.client)  # a restarted scheduler has lost this
            dispatcher = Dispatcher(
                cluster.client,
                stop=stop.is_set,
                slots=slots,
                priority=job.priority,
                no_worker_s=math.inf,  # workers of a batch system may wait for days
            )
            records = DaskRecords(cluster.client)
            self._work(job, Session(dispatcher, cluster.dashboard, (records,)))
        except Interrupted:
            return
        except ReportError as error:
            self._conclude(job, "finish", f"The page could not be written: {error}.")
        except ClusterError as error:
            self._set_back(job, error, cluster)
        except PalpateError as error:
            self._conclude(job, "fail", str(error))
        except Exception as error:
            if cluster.client.status != "running":
                self._set_back(job, ClusterError(f"The cluster is gone: {error}"), cluster)
            else:
                self._explain_crash(job, error)
        else:
            self._conclude(job, "finish")
        finally:
            slots.leave()

    def _work(self, job: Job, session: Session[Dispatcher]) -> None:
        folder = inside(self.home.root, self.home.job(job.id))
        store = self.home.store
        if job.kind == "study":
            run_queued_study(
                job.request, folder, store, session, self._tasks, reports=self._reports
            )
        else:
            run_queued_diagnosis(job.request, self._source(job), folder, store, session.dispatcher)

    def _source(self, job: Job) -> Path:
        """Return the location of the source of a diagnosis."""
        source = job.request["source"]
        if source.get("study"):
            return inside(self.home.root, self.home.job(source["study"]))
        path = self.uploads.resolve(source["upload"])
        if path is None:
            raise InputError(f"The upload {source['upload']} no longer exists: upload it again.")
        return path

    def _set_back(self, job: Job, error: ClusterError, cluster: Cluster) -> None:
        """Put a job back to waiting, or mark it failed if it makes no progress."""
        journal = StudyLayout(self.home.job(job.id)).journal
        size = journal.stat().st_size if journal.is_file() else 0
        setback = self._setbacks.setdefault(job.id, _Setback())
        setback.count = setback.count + 1 if size == setback.size else 1
        setback.size, setback.note = size, str(error)
        setback.not_before = time.monotonic() + REOPEN_S
        if cluster.client.status != "running":
            setback.count = 0  # not the job's fault
            self._cluster_lost.set()
        elif setback.count >= MOST_FAILURES:
            self._conclude(job, "fail", str(error))

    def _explain_crash(self, job: Job, error: Exception) -> None:
        _log.error("The job %s has crashed.", job.id, exc_info=error)
        folder = self.home.job(job.id)
        text = "".join(traceback.format_exception(error))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_file(folder / "crash.txt", text.encode())
        except (OSError, PalpateError):
            _log.exception("The traceback of %s cannot be written.", job.id)
        reason = f"internal error: {type(error).__name__}: {error}"
        self._conclude(job, "fail", f"{reason} (traceback in crash.txt)")

    def _conclude(self, job: Job, action: str, reason: str = "") -> None:
        self._setbacks.pop(job.id, None)
        try:
            if action == "finish":
                self.queue.change(job.id, "finish", reason)
            else:
                self.queue.change(job.id, "fail", reason)
        except StateError:  # paused or cancelled meanwhile: keep that state
            _log.info("The job %s has ended (%s), but was stopped meanwhile.", job.id, reason)
        except PalpateError:
            _log.exception("The end of %s cannot be recorded.", job.id)
            time.sleep(REOPEN_S)  # it is still waiting and will be retried
