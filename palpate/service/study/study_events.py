"""Events of a study: the loop reports them without knowing its observers; one writes the log.

::

    started            once, before anything is sent to the cluster
    prepared           the case and the target are in the store
    generation_begun   candidates of a generation are about to be evaluated
    evaluation_ended   once for each saved ending, in order of arrival
    generation_ended   all scores of a population are known
    stopped            the search has ended

When a study is resumed, the generations in the journal are reported again, in order, so an
observer sees the same events regardless of interruptions; endings from the journal are
reported with ``replayed=True``.

The log ``palpate.log`` in the folder of a study has the events with their times, and tracebacks.
"""

import logging
import math
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from palpate.service.search.search_interface import Generation
from palpate.storage.best_candidate import BestSoFar, score_of
from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.storage.values import PreparedBody, PreparedTarget
from palpate.workers.comparison.score_objective import GSF, Objective

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StudyFacts:
    """Facts about a study that are known before it runs.

    Parameters
    ----------
    name : str
        As in the study file.
    folder : str
        The folder of the journal.
    most_evaluations : int
        Number of evaluations if the search runs to its last generation.
    generations : int
        Maximum number of generations.
    workers : int
        Number of threads for evaluations at the start.
    dashboard : str
        Address of Dask's page; empty if there is none.
    objective : Objective
        The score that the search optimises.
    """

    name: str
    folder: str
    most_evaluations: int
    generations: int
    workers: int
    dashboard: str
    objective: Objective = GSF


class StopSearch(Exception):  # noqa: N818 - a request, not an error
    """Raised by an observer to end a search; its text becomes the reason.

    The current generation is finished first, so that each of its candidates has a score.
    """


class Observer:
    """Base class for receivers of the events of a study; override the methods of interest.

    A method that raises `StopSearch` ends the search.
    """

    def started(self, facts: StudyFacts) -> None:
        """Handle the start of the loop."""

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Handle the case or the target having been stored."""

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Handle the start of a generation with a number of evaluations."""

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Handle the saved ending of one candidate."""

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Handle the end of a generation, all of whose scores are known."""

    def stopped(self, reason: str) -> None:
        """Handle the end of the search."""


class Hooks(Observer):
    """Dispatch of every event to all observers; an observer that fails is dropped.

    Attributes
    ----------
    stop_reason : str or None
        The reason given by an observer to stop the search.
    """

    def __init__(self, observers: Iterable[Observer] = ()) -> None:
        self._observers = list(observers)
        self.stop_reason: str | None = None

    def add(self, observer: Observer) -> None:
        """Add an observer."""
        self._observers.append(observer)

    def _call(self, hook: str, *args: Any) -> None:
        for observer in list(self._observers):
            try:
                getattr(observer, hook)(*args)
            except StopSearch as wish:
                self.stop_reason = str(wish) or f"{type(observer).__name__} has stopped the search"
            except Exception:
                _log.exception("The observer %r failed in %s and is dropped.", observer, hook)
                self._observers.remove(observer)

    def started(self, facts: StudyFacts) -> None:
        """Pass the event on to all observers."""
        self._call("started", facts)

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Pass the event on to all observers."""
        self._call("prepared", what, record)

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Pass the event on to all observers."""
        self._call("generation_begun", number, evaluations)

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Pass the event on to all observers."""
        self._call("evaluation_ended", record, replayed)

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Pass the event on to all observers."""
        self._call("generation_ended", number, generation)

    def stopped(self, reason: str) -> None:
        """Pass the event on to all observers."""
        self._call("stopped", reason)


LOG_FORMAT = "%(asctime)s %(levelname)s %(message)s"


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
    handler.setFormatter(logging.Formatter(LOG_FORMAT))
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
