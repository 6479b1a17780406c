"""Calls observers of a study: the loop reports what happened and knows no observer.

::

    started            once, before anything is sent to the cluster
    prepared           the case and the target are in the store
    generation_begun   so many candidates are about to be evaluated
    evaluation_ended   once for each ending that is journalled, in order of arrival
    generation_ended   all scores of a population are known
    stopped            the search has found its end

On a resumed study the generations that the journal holds are reported again, in
order, so that an observer sees the same events however often a study was
interrupted; endings that were journalled before are reported with ``replayed=True``.
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
    """What is known of a study before it runs.

    Parameters
    ----------
    name : str
        As in the study file.
    folder : str
        Where the journal lies.
    most_evaluations : int
        If the search runs to its last generation.
    generations : int
        At most.
    workers : int
        Threads that evaluate, at the start.
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


class StopSearch(Exception):  # noqa: N818 - a wish, no error
    """Raised by an observer to end a search; its text becomes the reason.

    The generation that is under way is finished first, so that the study has a score for each of
    its candidates.
    """


class Observer:
    """Receives the events of a study; override those of interest.

    A method that raises `StopSearch` ends the search.
    """

    def started(self, facts: StudyFacts) -> None:
        """Note that the loop begins."""

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Note that the case or the target is in the store."""

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Note that a generation of so many evaluations begins."""

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Note the ending of one candidate, which the journal has."""

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Note that all candidates of a population have their scores."""

    def stopped(self, reason: str) -> None:
        """Note that the search is over."""


class Hooks(Observer):
    """Passes everything on to all observers; one that fails is dropped, not the study.

    Attributes
    ----------
    stop_reason : str or None
        Why an observer wants the search to end.
    """

    def __init__(self, observers: Iterable[Observer] = ()) -> None:
        self._observers = list(observers)
        self.stop_reason: str | None = None

    def add(self, observer: Observer) -> None:
        """Pass everything on to one more."""
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
        """Pass the event on."""
        self._call("started", facts)

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Pass the event on."""
        self._call("prepared", what, record)

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Pass the event on."""
        self._call("generation_begun", number, evaluations)

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Pass the event on."""
        self._call("evaluation_ended", record, replayed)

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Pass the event on."""
        self._call("generation_ended", number, generation)

    def stopped(self, reason: str) -> None:
        """Pass the event on."""
        self._call("stopped", reason)
