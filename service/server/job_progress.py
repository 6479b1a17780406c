"""How far a job is: a fold over its journal that reads each record once."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.server.journal_tail import JournalTail
from storage.layout import StudyLayout
from storage.plain import to_number
from storage.status import Status

RATE_OVER_S = 300.0


class JobProgress:
    """What the journal of one job says so far.

    Parameters
    ----------
    folder : Path
        Of the study or diagnosis.
    """

    def __init__(self, folder: Path) -> None:
        self._tail = JournalTail(StudyLayout(folder).journal)
        self._lock = threading.Lock()
        self.endings: Counter[str] = Counter()
        self.generations = 0
        self.best: dict[str, Any] | None = None
        self._best_rank: tuple[float, ...] | None = None
        self.stage_seconds: Counter[str] = Counter()
        self.phase: dict[str, Any] | None = None
        self.sessions = 0
        self.stopped = ""
        self._arrivals: deque[float] = deque(maxlen=10_000)
        self._first = True

    @property
    def bytes_read(self) -> int:
        """Return how much of the journal has been read."""
        return self._tail.offset

    def update(self) -> "JobProgress":
        """Read what is new.

        Raises
        ------
        JournalError
            If the journal is damaged.
        """
        with self._lock:
            while lines := self._tail.read():
                for line in lines:
                    self._apply(line.record)
            self._first = False
        return self

    @property
    def per_minute(self) -> float | None:
        """Return evaluations a minute of late; None if none has ended under our eyes."""
        now = time.monotonic()
        recent = [at for at in list(self._arrivals) if now - at < RATE_OVER_S]
        if len(recent) < 2:
            return None
        return 60.0 * len(recent) / max(now - recent[0], 1e-3)

    def _apply(self, record: dict[str, Any]) -> None:
        kind = record.get("kind")
        if kind == "evaluation":
            self._add_evaluation(record)
        elif kind == "generation":
            self.generations += 1
        elif kind == "session":
            self.sessions += 1
        elif kind == "step":
            self.phase = {key: record.get(key) for key in ("phase", "done", "of", "task")}
        elif kind == "end":
            self.stopped = str(record.get("reason", ""))

    def _add_evaluation(self, record: dict[str, Any]) -> None:
        self.endings[str(record.get("status"))] += 1
        if record.get("reused"):
            self.endings["reused"] += 1
        else:
            for stage, seconds in (record.get("seconds") or {}).items():
                self.stage_seconds[str(stage)] += seconds
        if not self._first:
            self._arrivals.append(time.monotonic())
        rank = _rank(record)
        if rank is not None and (self._best_rank is None or rank < self._best_rank):
            self._best_rank = rank
            self.best = {key: record[key] for key in ("candidate", "genes", "score")}


def _rank(record: Mapping[str, Any]) -> tuple[float, ...] | None:
    """Return what orders candidates as `service.search_replay.best_of` does; None unscored."""
    score, level, fit = record.get("score"), record.get("level"), record.get("fit")
    if not score or record.get("status") != Status.DONE:
        return None
    gsf = to_number(score)["gsf"]
    if gsf == math.inf:
        return None
    resolution = (0, 0) if level is None else (1, -level)
    by = (0, to_number(fit)["cost"]) if fit else (1, gsf)
    return (*resolution, *by, record["candidate"])


class ProgressBook:
    """The progress of all jobs, each kept from one question to the next."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_folder: dict[Path, JobProgress] = {}

    def of(self, folder: Path) -> JobProgress:
        """Return how far the job in a folder is.

        Raises
        ------
        JournalError
            If its journal is damaged.
        """
        with self._lock:
            progress = self._by_folder.setdefault(folder, JobProgress(folder))
        return progress.update()
