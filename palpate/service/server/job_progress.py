"""Progress of a job: a fold over its growing journal that reads each record once."""

import threading
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.service.study.study_progress import Pace
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import BestSoFar
from palpate.storage.errors import InputError, JournalError
from palpate.storage.journal import LineChain, line_before
from palpate.storage.journal_records import EvaluationRecord

READ_BYTES = 256 * 1024


@dataclass(frozen=True)
class JournalLine:
    """A record and the offset of the next one.

    Parameters
    ----------
    end : int
        Bytes of the journal up to and including this record.
    record : dict
    """

    end: int
    record: dict[str, Any]


class JournalTail:
    """New records of a journal, starting at an offset.

    Parameters
    ----------
    path : Path
        Need not exist yet.
    offset : int
        In bytes: 0, or the `JournalLine.end` of a record.

    Raises
    ------
    InputError
        If no record begins there.
    """

    def __init__(self, path: Path, offset: int = 0) -> None:
        self.path, self.offset = path, offset
        last = self._line_before() if offset else b""
        if offset and not last:
            raise InputError(
                f"No record begins at byte {offset} of this journal: start again from 0."
            )
        self._chain = LineChain(last)

    def read(self, most_bytes: int = READ_BYTES) -> list[JournalLine]:
        """Return complete unread records, if any.

        Raises
        ------
        JournalError
            If a line is damaged.
        """
        lines: list[JournalLine] = []
        try:
            with self.path.open("rb") as file:
                file.seek(self.offset)
                for line in file.readlines(most_bytes):
                    if not line.endswith(b"\n"):
                        break
                    record = self._parsed(line)
                    self.offset += len(line)
                    lines.append(JournalLine(self.offset, record))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise JournalError(f"{self.path} cannot be read: {error.strerror}.") from error
        return lines

    def _parsed(self, line: bytes) -> dict[str, Any]:
        try:
            record, _ = self._chain.read(line)
        except ValueError as error:
            raise JournalError(
                f"{self.path} is damaged after byte {self.offset}: {error}. "
                "`palpate status` explains how to repair it."
            ) from error
        return record

    def _line_before(self) -> bytes:
        try:
            with self.path.open("rb") as file:
                return line_before(file.fileno(), self.offset)
        except (OSError, ValueError, OverflowError):
            return b""


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
