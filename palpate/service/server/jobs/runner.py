"""Runner of queued jobs on one cluster, several at once.

Each waiting job runs in a thread of its own; the fair share limits its tasks on the cluster.
If the cluster is lost, it is opened again and the jobs continue.
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

from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.cluster.foreign_workers import prepare_workers
from palpate.service.cluster.open import Cluster
from palpate.service.errors import ClusterError, Interrupted
from palpate.service.server.jobs.diagnosis_job import run_diagnosis
from palpate.service.server.jobs.fair_share import FairShare
from palpate.service.server.jobs.home import ServiceHome, inside
from palpate.service.server.jobs.queue import Job, Queue, StateError
from palpate.service.server.jobs.study_job import ReportError, run_job
from palpate.service.server.jobs.uploads import Uploads
from palpate.service.study.loop import Tasks
from palpate.service.study.observers.dask_records import DaskRecords
from palpate.service.study.session import Session
from palpate.storage.backends.atomic import write_file
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.errors import InputError, PalpateError

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
            run_job(job.request, folder, store, session, self._tasks, reports=self._reports)
        else:
            run_diagnosis(job.request, self._source(job), folder, store, session.dispatcher)

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
