"""The log ``palpate.log`` in the folder of a study: events with their times, and tracebacks."""

import logging
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from palpate.service.search.base import Generation
from palpate.service.study.observers.hooks import Observer, StudyFacts
from palpate.storage.records.best_candidate import BestSoFar, score_of
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.status import Status
from palpate.storage.records.tasks import PreparedBody, PreparedTarget
from palpate.workers.comparison.similarity.objective import GSF

_log = logging.getLogger(__name__)

FORMAT = "%(asctime)s %(levelname)s %(message)s"


class _LogFile(logging.FileHandler):
    """A log file that never stops a study: records that cannot be written are skipped.

    If several studies run in threads of one process, each log has the records of its own thread.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path.absolute(), encoding="utf-8", delay=True)
        self._thread = threading.get_ident()

    def filter(self, record: logging.LogRecord) -> bool:
        """Accept records of this study's thread and of the one that writes the page."""
        ours = record.thread == self._thread or record.threadName == "page"
        return ours and bool(super().filter(record))

    def emit(self, record: logging.LogRecord) -> None:
        if Path(self.baseFilename).parent.is_dir():
            try:
                super().emit(record)
            except OSError:
                self.handleError(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Skip the record."""


@contextmanager
def logging_to(path: Path) -> Iterator["RunLog"]:
    """Append the log records of `service` to a file in an existing folder.

    Parameters
    ----------
    path : Path
    """
    handler = _LogFile(path)
    handler.setFormatter(logging.Formatter(FORMAT))
    logger = logging.getLogger("palpate.service")
    logger.addHandler(handler)
    _lower_level(logger)
    try:
        yield RunLog()
    except Exception as error:
        text = f"ended by {type(error).__name__}: {error}"
        _log.error("%s\n%s", text, getattr(error, "traceback", ""))
        raise
    finally:
        logger.removeHandler(handler)
        _restore_level(logger)
        handler.close()


_levels: list[int] = []  # the level before each open log
_levels_lock = threading.Lock()


def _lower_level(logger: logging.Logger) -> None:
    """Make a logger accept INFO while a log is open."""
    with _levels_lock:
        _levels.append(logger.level)
        logger.setLevel(logging.INFO)


def _restore_level(logger: logging.Logger) -> None:
    """Restore a logger's level when the last log is closed."""
    with _levels_lock:
        before = _levels.pop()
        if not _levels:
            logger.setLevel(before)


class RunLog(Observer):
    """Observer that logs the events of a study."""

    def __init__(self) -> None:
        self._ranked = BestSoFar()
        self._objective = GSF

    def started(self, facts: StudyFacts) -> None:
        """Log the study, its workers and its folder."""
        self._objective = facts.objective
        _log.info("%s runs on %d workers %s", facts.name, facts.workers, facts.dashboard)

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Log that the body or target is ready."""
        _log.info("%s prepared: %s", what, dict(record))

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Log a new generation."""
        _log.info("generation %d begun: %d candidates", number + 1, evaluations)

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Log a failed evaluation; the others are in the journal only."""
        self._ranked.add(record)
        if replayed or record.status is Status.DONE:
            return
        text = f"candidate {record.candidate} {record.status}: {record.reason}"
        _log.warning(text + (f"\n{record.traceback.rstrip()}" if record.traceback else ""))

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Log the best candidate so far."""
        best = self._ranked.record
        score = math.inf if best is None else score_of(best)
        _log.info("generation %d done: best %s %.6g", number + 1, self._objective.axis, score)

    def stopped(self, reason: str) -> None:
        """Log the reason why the search stopped."""
        _log.info("stopped: %s", reason)

    def note(self, text: str) -> None:
        """Log a remark from a command."""
        _log.info(text)
