"""Evaluation of proposed candidates; their endings go to the journal."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from palpate.service.cluster.dispatch import Ending, TaskRunner
from palpate.service.search.base import Generation
from palpate.service.study.endings import (
    blame_cluster_if_many,
    evaluation_record,
    refuse_if_all_crashed,
)
from palpate.service.study.observers.hooks import Hooks
from palpate.service.study.replay import PendingGeneration
from palpate.service.study.requests import StudyWork
from palpate.storage.records.best_candidate import best_of, score_of
from palpate.storage.records.evaluations import load_evaluation
from palpate.storage.records.journal import Journal
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.status import Status
from palpate.storage.records.tasks import EvaluationRequest
from palpate.storage.stores.volumes import has_volume


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
