"""The queue of a service: submitted jobs and their states, as a fold over a journal.

::

    waiting --+--> finished            all computed
      ^  |    +--> failed              with a reason; can be resumed
      |  |    `--> cancelled           by a user, permanently
      |  v
     paused                            by a user; can be resumed

Whether a waiting job is running is not recorded: a restarted service runs all waiting
jobs.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from palpate.service.server.jobs.home_and_tokens import RESERVED_NAMES
from palpate.storage.errors import JournalError, PalpateError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import SCHEMA_VERSION

JobKind = Literal["study", "diagnosis"]
JobState = Literal["waiting", "paused", "finished", "failed", "cancelled"]
Action = Literal["pause", "resume", "cancel", "finish", "fail"]

# The allowed states of each action, and the state that follows.
ACTIONS: dict[Action, tuple[set[JobState], JobState]] = {
    "pause": ({"waiting", "paused"}, "paused"),
    "resume": ({"waiting", "paused", "failed"}, "waiting"),
    "cancel": ({"waiting", "paused", "failed", "cancelled"}, "cancelled"),
    "finish": ({"waiting", "paused", "cancelled"}, "finished"),
    "fail": ({"waiting"}, "failed"),
}


class StateError(PalpateError):
    """An action that is not allowed in the state of a job."""


@dataclass(frozen=True)
class Job:
    """One study or diagnosis of the queue.

    Parameters
    ----------
    id : str
        Name of the job and of its folder.
    kind : {"study", "diagnosis"}
    owner : str
        Name of the token that submitted it.
    priority : int
        Jobs of higher priority get workers first.
    submitted, changed : str
        Date and time, ISO 8601.
    request : mapping
        The request; see `service.server.jobs`.
    key : str
        Text chosen by the client: the same key from the same owner identifies the same job.
    number : int
        Order of submission, from 0.
    state : str
    reason : str
        Reason for a failure; empty otherwise.
    """

    id: str
    kind: JobKind
    owner: str
    priority: int
    submitted: str
    request: Mapping[str, Any] = field(repr=False)
    key: str = ""
    number: int = 0
    state: JobState = "waiting"
    reason: str = ""
    changed: str = ""


class Queue:
    """The jobs of a service; changes are written to disk before they take effect.

    Parameters
    ----------
    path : Path
        Path of its journal, which is locked.

    Raises
    ------
    JournalError
        If another service uses it, or it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.RLock()
        self._jobs: dict[str, Job] = {}
        self.version = 0
        try:
            self._journal = Journal(path)
        except JournalError as error:
            if "being written" not in str(error):
                raise
            raise JournalError(
                f"Another `palpate serve` is using {path.parent.parent}: stop it, or serve another "
                "folder."
            ) from error
        for record in Journal.read(path):
            self._apply(record)

    def close(self) -> None:
        """Release the lock of the journal."""
        with self._lock:
            self._journal.close()

    @property
    def jobs(self) -> list[Job]:
        """Return all jobs in the order of submission."""
        with self._lock:
            return list(self._jobs.values())

    def get(self, identifier: str) -> Job | None:
        """Return a job; None if it does not exist."""
        with self._lock:
            return self._jobs.get(identifier)

    def submit(
        self,
        kind: JobKind,
        name: str,
        owner: str,
        request: Mapping[str, Any],
        *,
        priority: int = 0,
        key: str = "",
        taken: Callable[[str], bool] = lambda identifier: False,
    ) -> tuple[Job, bool]:
        """Add a job; return it and whether it is new.

        Parameters
        ----------
        name : str
            Becomes the job's id, with a number appended if it is taken.
        taken : callable
            Returns whether an id is unavailable for another reason.
        """
        with self._lock:
            if key:
                for job in self._jobs.values():
                    if (job.owner, job.key) == (owner, key):
                        return job, False
            identifier = self._free(name, taken)
            record = {
                "kind": "submitted",
                "job": identifier,
                "job_kind": kind,
                "owner": owner,
                "priority": priority,
                "at": _now(),
                "key": key,
                "request": dict(request),
            }
            self._append(record)
            return self._jobs[identifier], True

    def change(self, identifier: str, action: Action, reason: str = "") -> Job:
        """Change the state of a job.

        Raises
        ------
        StateError
            If its state does not allow it.
        """
        with self._lock:
            job = self._jobs[identifier]
            allowed, becomes = ACTIONS[action]
            if job.state not in allowed:
                raise StateError(
                    f"{identifier} is {job.state}: it cannot become {becomes}. That is possible "
                    f"while a job is {' or '.join(sorted(allowed))}."
                )
            if job.state != becomes:
                self._append(
                    {"kind": "changed", "job": identifier, "to": becomes}
                    | {"reason": reason, "at": _now()}
                )
            return self._jobs[identifier]

    def prioritise(self, identifier: str, priority: int) -> Job:
        """Change the priority of a job; running tasks are completed first."""
        with self._lock:
            if self._jobs[identifier].priority != priority:
                self._append(
                    {"kind": "priority", "job": identifier, "priority": priority, "at": _now()}
                )
            return self._jobs[identifier]

    def _free(self, name: str, taken: Callable[[str], bool]) -> str:
        identifier, number = name, 1
        while identifier in self._jobs or identifier in RESERVED_NAMES or taken(identifier):
            number += 1
            identifier = f"{name}-{number}"
        return identifier

    def _append(self, record: dict[str, Any]) -> None:
        self._journal.append({"schema_version": SCHEMA_VERSION} | record)
        self._apply(record)

    def _apply(self, record: Mapping[str, Any]) -> None:
        try:
            kind, identifier = record["kind"], record["job"]
            if kind == "submitted":
                self._jobs[identifier] = Job(
                    id=identifier,
                    kind=record["job_kind"],
                    owner=record["owner"],
                    priority=record["priority"],
                    submitted=record["at"],
                    request=record["request"],
                    key=record["key"],
                    number=len(self._jobs),
                    changed=record["at"],
                )
            else:
                job = self._jobs[identifier]
                if kind == "priority":
                    job = replace(job, priority=record["priority"])
                else:
                    job = replace(job, state=record["to"], reason=record["reason"])
                self._jobs[identifier] = replace(job, changed=record["at"])
        except (KeyError, TypeError) as error:
            raise JournalError(
                f"The journal of the queue has an invalid record ({error!r}): it was "
                "edited. Move .service/queue.jsonl aside and submit the studies again; "
                "completed evaluations are reused."
            ) from error
        self.version += 1


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
