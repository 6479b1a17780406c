"""Events of a study: the loop reports them without knowing its observers.

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
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from palpate.service.search.base import Generation
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.tasks import PreparedBody, PreparedTarget
from palpate.workers.comparison.similarity.objective import GSF, Objective

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
