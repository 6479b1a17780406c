"""Keeps palpate.log in the folder of a study: what happened when, tracebacks included."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from service.hooks import Observer, StudyFacts
from service.search.base import Generation
from storage.records import EvaluationRecord
from storage.status import Status
from storage.task_records import PreparedBody, PreparedTarget

_log = logging.getLogger(__name__)

FORMAT = "%(asctime)s %(levelname)s %(message)s"


class _LogFile(logging.FileHandler):
    """A log is no reason to stop a study: what cannot be written is left out."""

    def emit(self, record: logging.LogRecord) -> None:
        if Path(self.baseFilename).parent.is_dir():
            try:
                super().emit(record)
            except OSError:
                self.handleError(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Leave it out."""


@contextmanager
def logging_to(path: Path) -> Iterator["RunLog"]:
    """Append what `service` logs to a file; the folder is made by others.

    Parameters
    ----------
    path : Path
    """
    handler = _LogFile(path.absolute(), encoding="utf-8", delay=True)
    handler.setFormatter(logging.Formatter(FORMAT))
    logger = logging.getLogger("service")
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield RunLog()
    except Exception as error:
        text = f"ended by {type(error).__name__}: {error}"
        _log.error("%s\n%s", text, getattr(error, "traceback", ""))
        raise
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)
        handler.close()


class RunLog(Observer):
    """Logs the events of a study."""

    def started(self, facts: StudyFacts) -> None:
        """Log what begins, and where."""
        _log.info("%s runs on %d workers %s", facts.name, facts.workers, facts.dashboard)

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Log that body or target are there."""
        _log.info("%s prepared: %s", what, dict(record))

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Log a new generation."""
        _log.info("generation %d begun: %d candidates", number + 1, evaluations)

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Log what has failed; the journal has the rest."""
        if replayed or record.status is Status.DONE:
            return
        text = f"candidate {record.candidate} {record.status}: {record.reason}"
        _log.warning(text + (f"\n{record.traceback.rstrip()}" if record.traceback else ""))

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Log the best score."""
        _log.info("generation %d done: best GSF %.6g", number + 1, generation.scores.min())

    def stopped(self, reason: str) -> None:
        """Log why the search has stopped."""
        _log.info("stopped: %s", reason)

    def note(self, text: str) -> None:
        """Log a remark of a command."""
        _log.info(text)
