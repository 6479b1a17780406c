"""Progress of a job: a fold over its journal that reads each record once."""

import threading
from collections import Counter
from pathlib import Path
from typing import Any

from palpate.service.server.live.journal_tail import JournalTail
from palpate.service.study.count import Pace
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.records.best_candidate import BestSoFar
from palpate.storage.records.record import EvaluationRecord


class JobProgress:
    """The progress of one job according to its journal.

    Parameters
    ----------
    folder : Path
        Folder of the study or diagnosis.
    """

    def __init__(self, folder: Path) -> None:
        self._tail = JournalTail(StudyLayout(folder).journal)
        self._lock = threading.Lock()
        self.endings: Counter[str] = Counter()
        self.generations = 0
        self.ranked = BestSoFar()
        self.stage_seconds: Counter[str] = Counter()
        self.phase: dict[str, Any] | None = None
        self.sessions = 0
        self.stopped = ""
        self._pace = Pace()
        self._workers = 1
        self._first = True

    @property
    def bytes_read(self) -> int:
        """Return the number of bytes read from the journal."""
        return self._tail.offset

    def update(self) -> "JobProgress":
        """Read new records.

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
        """Return the recent evaluations per minute; None before the first have ended here."""
        return self._pace.per_minute(self._workers)

    @property
    def best(self) -> EvaluationRecord | None:
        """Return the best candidate so far; None if none has a score."""
        return self.ranked.record

    def _apply(self, record: dict[str, Any]) -> None:
        kind = record.get("kind")
        if kind == "evaluation":
            self._add_evaluation(record)
        elif kind == "generation":
            self.generations += 1
        elif kind == "session":
            self.sessions += 1
            self._workers = max(1, int(record.get("workers") or 1))
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
                self._pace.add(sum((record.get("seconds") or {}).values()))
        self.ranked.add_line(record)


class ProgressBook:
    """The progress of all jobs, kept between requests."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_folder: dict[Path, JobProgress] = {}

    def of(self, folder: Path) -> JobProgress:
        """Return the progress of the job in a folder.

        Raises
        ------
        JournalError
            If its journal is damaged.
        """
        with self._lock:
            progress = self._by_folder.setdefault(folder, JobProgress(folder))
        return progress.update()
