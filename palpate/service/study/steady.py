"""Evaluation of a steady search: a new candidate is bred whenever one has ended."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from palpate.service.cluster.dispatch import NOT_YET, Ending
from palpate.service.search.base import Generation, Stopped
from palpate.service.search.steady import SteadyGenetic
from palpate.service.study.endings import blame_cluster_if_many, refuse_if_all_crashed
from palpate.service.study.evaluations import EvaluationRun
from palpate.service.study.replay import PendingGeneration
from palpate.service.study.steady_replay import SteadyReplay
from palpate.storage.records.evaluations import load_evaluation
from palpate.storage.records.record import EvaluationRecord

BlockEnded = Callable[[int, Generation, bool], None]
"""Called after every block with its number, its endings, and whether they were replayed."""


class SteadyRun:
    """One run of a study without barriers between generations.

    Parameters
    ----------
    search : SteadyGenetic
    evaluation : EvaluationRun
    block_ended : callable
        See `BlockEnded`.
    reason_to_stop : callable
        Returns the reason to propose no further candidates, or None.
    """

    def __init__(
        self,
        search: SteadyGenetic,
        evaluation: EvaluationRun,
        block_ended: BlockEnded,
        reason_to_stop: Callable[[], str | None],
    ) -> None:
        self._reason_to_stop = reason_to_stop
        self._evaluation, self._block_ended = evaluation, block_ended
        self._replay = SteadyReplay(search)
        self._size = search.settings.population
        self._sharing: dict[str, list[int]] = {}  # equal candidates share one evaluation
        self._crashed: list[Ending] = []  # not saved as long as every candidate crashes
        self._lost: list[Ending] = []
        self._history: list[Generation] = []
        self._stopped: Stopped | None = None

    def to_the_end(
        self, endings: Mapping[int, EvaluationRecord]
    ) -> tuple[Stopped, tuple[Generation, ...]]:
        """Return the reason why the search stopped, and its endings in blocks.

        Parameters
        ----------
        endings : mapping of int to EvaluationRecord
            The endings in the journal at the start of the run, in their order.
        """
        hooks, dispatcher = self._evaluation.hooks, self._evaluation.dispatcher
        hooks.generation_begun(0, self._size)
        for record in list(endings.values()):
            hooks.evaluation_ended(record, True)
            self._add(record, replayed=True)
        for ending in dispatcher.run(self._evaluation.work.evaluate, self._calls()):
            self._take(ending)
        self._write_down_crashed()
        if self._replay.ended % self._size:
            self._end_block(replayed=not self._evaluated_anything(endings))
        assert self._stopped is not None
        return self._stopped, tuple(self._history)

    def _evaluated_anything(self, before: Mapping[int, EvaluationRecord]) -> bool:
        return self._replay.ended > len(before)

    def _calls(self) -> Iterator[Any]:
        """Yield the next evaluations; `NOT_YET` while the next one has to wait."""
        while not isinstance(pending := self._proposed(), Stopped):
            if pending is None:
                if len(self._crashed) == len(self._sharing):  # nothing else is running
                    self._write_down_crashed()
                yield NOT_YET
            else:
                yield from self._call(pending)
        self._stopped = pending

    def _proposed(self) -> PendingGeneration | Stopped | None:
        reason = self._reason_to_stop()
        return self._replay.propose() if reason is None else Stopped(reason)

    def _call(self, pending: PendingGeneration) -> Iterator[Any]:
        evaluation, candidate = self._evaluation, pending.first
        if candidate in evaluation.endings:
            pending.check(evaluation.endings[candidate])
            return
        evaluation.proposed[candidate] = pending
        request = evaluation.request(candidate)
        name = request["digest"]
        if name in self._sharing:
            self._sharing[name].append(candidate)
            return
        self._sharing[name] = [candidate]
        stored = load_evaluation(evaluation.work.store, name)
        if stored is None:
            yield name, evaluation.work.arguments(request)
        else:
            self._write_down(Ending(name, "returned", stored), reused=True)

    def _take(self, ending: Ending) -> None:
        if ending.kind == "lost":
            self._lost.append(ending)
            blame_cluster_if_many(self._lost, max(self._size, self._replay.ended))
        if ending.kind == "crashed" and not self._replay.ended:
            self._crashed.append(ending)
            return
        self._write_down(ending)
        self._write_down_all(self._crashed)

    def _write_down_crashed(self) -> None:
        refuse_if_all_crashed(self._crashed, 0)
        self._write_down_all(self._crashed)

    def _write_down_all(self, endings: list[Ending]) -> None:
        while endings:
            self._write_down(endings.pop(0))

    def _write_down(self, ending: Ending, *, reused: bool = False) -> None:
        candidates = self._sharing.pop(ending.key)
        self._evaluation.write_down(candidates, ending, reused=reused)
        for record in [self._evaluation.endings[candidate] for candidate in candidates]:
            self._add(record, replayed=False)

    def _add(self, record: EvaluationRecord, *, replayed: bool) -> None:
        self._replay.add(record)
        if self._replay.ended % self._size == 0:
            self._end_block(replayed=replayed)
            self._evaluation.hooks.generation_begun(len(self._history), self._size)

    def _end_block(self, *, replayed: bool) -> None:
        self._history.append(self._replay.last_block())
        self._block_ended(len(self._history) - 1, self._history[-1], replayed)
        if self._evaluation.work.spec.keep != "elites":  # which are known only at the end
            self._evaluation.forget(self._replay.proposed)
