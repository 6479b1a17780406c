"""Evaluation of proposed candidates; their endings go to the journal.

Errors are raised when the cluster or the model is to blame for the endings. A steady search has a
new candidate bred whenever one has ended.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from palpate.service.cluster.task_dispatch import NOT_YET, Ending, TaskRunner
from palpate.service.errors_and_interrupts import ClusterError, GenerationCrashError
from palpate.service.search.genetic_search import SteadyGenetic
from palpate.service.search.search_interface import Generation, Stopped
from palpate.service.study.search_replay import PendingGeneration, SteadyReplay
from palpate.service.study.study_events import Hooks
from palpate.service.study.task_requests import StudyWork
from palpate.storage.best_candidate import best_of, minimised, score_of
from palpate.storage.journal import Journal
from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.storage.store import load_evaluation
from palpate.storage.stored_arrays import has_volume
from palpate.storage.values import EvaluationRequest, EvaluationResult

# If a generation loses more than this share of its candidates, the cluster is to blame.
MAX_LOST_SHARE = 0.2
# Differences between two messages for the same reason.
NUMBERS = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
NO_SHARED_TISSUE = "it has no score: candidate and target have no compared tissue in common"


def blame_cluster_if_many(lost: list[Ending], evaluations: int) -> None:
    """Raise an error if many evaluations are lost: the cluster is to blame, not a candidate."""
    if len(lost) > max(1, MAX_LOST_SHARE * evaluations):
        raise ClusterError(
            f"{len(lost)} of {evaluations} candidates have repeatedly lost their workers: "
            f"{lost[0].reason}. The workers may have too little memory: start fewer with "
            "--workers, then run the study again; completed work is kept."
        )


def refuse_if_all_crashed(crashed: list[Ending], generation: int) -> None:
    """Raise an error if all candidates crash for the same reason, which would recur."""
    reasons = {NUMBERS.sub("#", ending.reason) for ending in crashed}
    if len(crashed) > 1 and len(reasons) == 1:
        raise GenerationCrashError(
            f"All {len(crashed)} candidates of generation {generation + 1} have crashed for the "
            f"same reason: {crashed[0].reason}. None of them is saved: correct the cause, and "
            "run the same command again to continue the study.",
            crashed[0].traceback,
        )


def evaluation_record(
    pending: PendingGeneration, candidate: int, ending: Ending, reused: bool
) -> EvaluationRecord:
    """Return the journal record of an ending."""
    return ending_record(
        ending,
        candidate=candidate,
        generation=pending.number,
        genes=pending.genes(candidate),
        reused=reused,
        level=pending.proposal.level,
    )


def ending_record(
    ending: Ending,
    *,
    candidate: int,
    generation: int,
    genes: Mapping[str, float],
    reused: bool,
    level: int | None = None,
) -> EvaluationRecord:
    """Return the record of an ending; see `EvaluationRecord`."""
    record = partial(
        EvaluationRecord,
        candidate=candidate,
        generation=generation,
        genes=genes,
        digest=ending.key,
        attempts=max(1, ending.attempts),
        reused=reused,
        level=level,
    )
    result: EvaluationResult | None = ending.value
    if result is None:
        status = Status.CRASHED if ending.kind == "crashed" else Status.LOST
        traceback = ending.traceback if status is Status.CRASHED else ""
        return record(status=status, reason=ending.reason, traceback=traceback)
    record = partial(
        record,
        outcome=result.get("outcome"),
        seconds=result.get("seconds", {}),
        worker=result.get("worker", ""),
        fit=result.get("fit"),
    )
    score = result.get("score")
    if result["status"] == "done" and score is not None and minimised(score) < math.inf:
        return record(status=Status.DONE, score=score)
    return record(status=Status.DIVERGED, reason=result.get("reason") or NO_SHARED_TISSUE)


@dataclass(eq=False)
class EvaluationRun:
    """The evaluations of one run of a study.

    Parameters
    ----------
    work : StudyWork
    journal : Journal
    hooks : Hooks
    endings : dict of int to EvaluationRecord
        Endings of all candidates so far; updated in place.

    Attributes
    ----------
    proposed : dict of int to PendingGeneration
        The generation of each candidate that has not ended.
    """

    work: StudyWork
    journal: Journal
    hooks: Hooks
    endings: dict[int, EvaluationRecord]
    proposed: dict[int, PendingGeneration] = field(default_factory=dict)
    _earlier: set[str] = field(default_factory=set)  # digests of forgotten endings

    @property
    def dispatcher(self) -> TaskRunner:
        """Return the task runner."""
        return self.work.dispatcher

    def evaluate(self, pending: PendingGeneration) -> None:
        """Evaluate a generation until every candidate has an ending."""
        sharing: dict[str, list[int]] = {}  # equal candidates have one evaluation
        requests: dict[str, EvaluationRequest] = {}
        for candidate in pending.candidates:
            if candidate in self.endings:
                pending.check(self.endings[candidate])
                self.hooks.evaluation_ended(self.endings[candidate], True)
                continue
            self.proposed[candidate] = pending
            request = self.request(candidate)
            sharing.setdefault(request["digest"], []).append(candidate)
            requests[request["digest"]] = request
        calls = []
        for name, candidates in sharing.items():
            stored = load_evaluation(self.work.store, name)
            if stored is None:
                calls.append((name, self.work.arguments(requests[name])))
            else:
                ending = Ending(name, "returned", stored)
                self.write_down(candidates, ending, reused=True)
        lost = []
        crashed = []  # not saved as long as every candidate crashes
        others = self._has_other_endings(pending)
        for ending in self.dispatcher.run(self.work.evaluate, calls):
            if ending.kind == "lost":
                lost.append(ending)
                blame_cluster_if_many(lost, len(calls))
            elif ending.kind == "crashed" and not others:
                crashed.append(ending)
            else:
                others = True
                for earlier in [*crashed, ending]:
                    self.write_down(sharing[earlier.key], earlier, reused=False)
                crashed.clear()
        if not lost:
            refuse_if_all_crashed(crashed, pending.number)
        for ending in [*crashed, *lost]:
            self.write_down(sharing[ending.key], ending, reused=False)

    def _has_other_endings(self, pending: PendingGeneration) -> bool:
        """Return True if a candidate of a generation has ended other than by a crash.

        A candidate evaluated in an earlier generation does not count.
        """
        earlier = {r.digest for r in self.endings.values() if r.generation < pending.number}
        earlier |= self._earlier
        ended = [self.endings[c] for c in pending.candidates if c in self.endings]
        return any(r.status is not Status.CRASHED and r.digest not in earlier for r in ended)

    def forget(self, before: int) -> None:
        """Forget the endings of candidates that are no longer needed, except the best ones.

        They stay in the journal. For 20,000 evaluations the records would take 60 MB of memory.

        Parameters
        ----------
        before : int
            Candidates with lower numbers are forgotten.
        """
        best = best_of(self.endings)
        kept = None if best is None else best.candidate
        for candidate in [c for c in self.endings if c < before and c != kept]:
            self._earlier.add(self.endings.pop(candidate).digest)

    def keep_volumes(self, pending: PendingGeneration, generation: Generation) -> None:
        """Store the deformed volumes requested by the study file."""
        if self.work.spec.keep == "best":
            return
        count = (
            len(generation.scores) if self.work.spec.keep == "all" else self.work.spec.search.elite
        )
        kept = [pending.first + int(index) for index in generation.ranking[:count]]
        self.make_volumes([c for c in kept if pending.carried_from(c) is None])

    def keep_best(self) -> None:
        """Store the volumes of the best candidates, one for each elite, if requested."""
        if self.work.spec.keep == "elites":
            ranked = sorted(self.endings, key=lambda c: (score_of(self.endings[c]), c))
            self.make_volumes(ranked[: self.work.spec.search.elite])

    def make_volumes(self, candidates: list[int]) -> None:
        """Store the deformed volumes of candidates, computed from stored fields."""
        calls = []
        for candidate in candidates:
            ending = self.endings[candidate]
            if ending.status is Status.DONE and not has_volume(self.work.store, ending.digest):
                calls.append((candidate, (self.request(candidate),)))
        self.dispatcher.all(self.work.tasks.keep_volume, calls)

    def differentiate(self, candidate: int) -> Ending:
        """Evaluate a candidate again, with derivatives."""
        request = self.request(candidate, derivatives=True)
        calls = [(request["digest"], self.work.arguments(request))]
        (ending,) = self.dispatcher.run(self.work.evaluate, calls)
        return ending

    def findings(self, candidate: int) -> Mapping[str, Any]:
        """Return the organ's findings about a candidate's body, other than its constants."""
        return self.dispatcher.call(self.work.tasks.find, self.request(candidate, derivatives=True))

    def write_down(self, candidates: list[int], ending: Ending, *, reused: bool) -> None:
        """Save an ending for all candidates that share it, then notify the observers."""
        records = [
            evaluation_record(
                self.proposed.pop(candidate), candidate, ending, reused or position > 0
            )
            for position, candidate in enumerate(candidates)
        ]
        self.journal.append(*(record.to_json() for record in records))
        for record in records:
            self.endings[record.candidate] = record
            self.hooks.evaluation_ended(record, False)

    def request(self, candidate: int, *, derivatives: bool = False) -> EvaluationRequest:
        """Return the request of a proposed or completed candidate."""
        ended, pending = self.endings.get(candidate), self.proposed.get(candidate)
        if ended is not None:
            wanted = derivatives or ended.fit is not None
            return self.work.request(ended.genes, ended.level, derivatives=wanted)
        assert pending is not None
        wanted, level = derivatives or pending.proposal.derivatives, pending.proposal.level
        return self.work.request(pending.genes(candidate), level, derivatives=wanted)


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
