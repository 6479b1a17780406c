"""Runs a study: propose candidates, evaluate them, journal the endings, score generations.

Running a study and resuming it are the same: the journal says which candidates
have an ending, the search proposes what it proposed before, and what has no
ending is evaluated. Scores are handed to the search in the order of the candidates, so neither
the number of workers nor an interruption changes what is proposed next.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from service.dispatch import Dispatcher, Ending
from service.endings import blame_cluster_if_many, evaluation_record, refuse_if_all_crashed
from service.hooks import Hooks, Observer, StudyFacts
from service.search.base import Generation, Stopped
from service.search_replay import PendingGeneration, SearchReplay, best_of
from service.spec import StudySpec
from service.study_folder import StudyFolder
from service.study_log import StudyLog
from service.study_work import StudyWork, Tasks
from service.versions import versions
from storage.atomic import write_file
from storage.evaluations import load_evaluation
from storage.journal import Journal
from storage.places import Location, place_of
from storage.plain import dumps
from storage.records import (
    EndRecord,
    EvaluationRecord,
    GenerationRecord,
    IdentificationRecord,
    SessionRecord,
)
from storage.status import Status
from storage.stores import Store, open_store
from storage.task_records import (
    EvaluationRequest,
)
from storage.volumes import has_volume
from workers.organs.registry import organ_named

__all__ = ["Conclusion", "Study", "Tasks"]


@dataclass(frozen=True)
class Conclusion:
    """How a search ended.

    Parameters
    ----------
    reason : str
        Why it stopped.
    best : EvaluationRecord or None
        None if no candidate has a score.
    history : tuple of Generation
        All its generations.
    """

    reason: str
    best: EvaluationRecord | None
    history: tuple[Generation, ...]


class Study:
    """One study and its folder.

    Parameters
    ----------
    spec : StudySpec
        The study file.
    folder : Path
        Made when missing; continued when it holds this study.
    store : str or Path, optional
        Where volumes and evaluations go. Default: that of the last run, else the
        folder ``store`` beside `folder`.
    tasks : Tasks
        What is sent to the workers.
    observers : iterable of Observer
        Hear what happens.
    accept_new_code : bool
        Continue although the code has changed since the last run.

    Attributes
    ----------
    ended, begun : bool
        Whether its search has stopped; whether body and target were ever prepared.
    store : Path or ObjectPath
        Where volumes and evaluations go.

    Raises
    ------
    InputError
        If `folder` holds another study, or one run with other code.
    JournalError
        If its journal is damaged.
    """

    def __init__(
        self,
        spec: StudySpec,
        folder: Path,
        store: Location | None = None,
        *,
        tasks: Tasks | None = None,
        observers: Iterable[Observer] = (),
        accept_new_code: bool = False,
    ) -> None:
        self.spec = spec
        self.tasks = tasks or Tasks()
        self.hooks = Hooks(observers)
        self.folder = StudyFolder(folder, spec, accept_new_code=accept_new_code)
        log = self.folder.check()
        self.ended = log.end is not None
        self.begun = bool(log.sessions)
        self.store = place_of(store or self.folder.default_store(log))
        self._given_store = store

    def run(self, dispatcher: Dispatcher, dashboard: str = "") -> Conclusion:
        """Run the study to its end, from wherever it stands.

        Raises
        ------
        InputError
            If the case or the target makes no sense.
        StoreError
            If store or journal cannot be used; a study that is running already.
        ClusterError
            If the workers cannot do the work; what is journalled is kept.
        Interrupted
            If the dispatcher is told to stop.
        """
        with self.folder.open() as journal:
            log = self.folder.begin(journal)
            store = open_store(self._given_store or self.folder.default_store(log))
            return _Run(self, journal, log, store, dispatcher).to_the_end(dashboard)


class _Run:
    """One run of a study, its journal locked."""

    def __init__(
        self, study: Study, journal: Journal, log: StudyLog, store: Store, dispatcher: Dispatcher
    ) -> None:
        self.study, self.spec, self.tasks, self.hooks = study, study.spec, study.tasks, study.hooks
        self.journal, self.log, self.store, self.dispatcher = journal, log, store, dispatcher
        self.began = time.monotonic()
        self.endings = dict(log.endings)
        self.case = self.spec.case.model_dump(mode="json")

    def to_the_end(self, dashboard: str) -> Conclusion:
        self._announce(dashboard)
        work = self._prepare()
        search = SearchReplay(self.spec.search_strategy, self.spec.search.space)
        evaluation = _GenerationRun(self, work)
        generations: list[PendingGeneration] = []
        while isinstance(pending := search.propose(), PendingGeneration):
            generations.append(pending)
            self.hooks.generation_begun(pending.number, pending.proposal)
            evaluation.evaluate(pending)
            generation = search.complete(pending, self.endings)
            evaluation.keep_volumes(pending, generation)
            if not self.log.endings.keys() >= set(pending.candidates):
                best = float(generation.scores.min())
                self._append(GenerationRecord(pending.number, best, self._elapsed_s()))
            self.hooks.generation_ended(pending.number, generation)
        best_candidate = best_of(self.endings)
        if best_candidate is not None and self.log.identification is None:
            self._identify(generations[best_candidate.generation], best_candidate, evaluation)
        if self.log.end is None:
            self._append(self._end(pending, best_candidate, generations, evaluation))
        self.hooks.stopped(pending.reason)
        return Conclusion(pending.reason, best_candidate, tuple(search.history))

    def _announce(self, dashboard: str) -> None:
        facts = StudyFacts(
            name=self.spec.name,
            folder=str(self.study.folder.root),
            most_evaluations=self.spec.most_evaluations,
            generations=self.spec.most_generations,
            workers=self.dispatcher.threads,
            dashboard=dashboard,
        )
        self.hooks.started(facts)

    def _prepare(self) -> StudyWork:
        """Bring case and target into the store, which is quick when they are there."""
        store, workers = str(self.store.root), self.dispatcher.threads
        body = self.dispatcher.call(self.tasks.prepare, self.case, store)
        self.hooks.prepared("case", body)
        target_spec = self.spec.target.model_dump(mode="json")
        target = self.dispatcher.call(self.tasks.target, self.case, target_spec, store)
        self.hooks.prepared("target", target)
        self.study.folder.check_same(self.log, body, target)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        self._append(
            SessionRecord(now, store, versions(), body, target, workers, self._elapsed_s())
        )
        target_name = target["target"]
        return StudyWork(self.spec, self.tasks, self.store, self.dispatcher, body, target_name)

    def _end(
        self,
        stopped: Stopped,
        best: EvaluationRecord | None,
        generations: list[PendingGeneration],
        evaluation: "_GenerationRun",
    ) -> EndRecord:
        if best is None:
            return EndRecord(stopped.reason, None, None, {}, {}, self._elapsed_s())
        evaluation.make_volumes(generations[best.generation], [best.candidate])
        work = evaluation.work
        at = work.resolution(best.level)
        before = work.compare_with_target(at, at.body["volume"])
        after = work.compare_with_target(at, best.digest)
        found = evaluation.findings(generations[best.generation], best.candidate)
        write_file(self.study.folder.layout.findings, dumps(found).encode())
        reason, elapsed_s = stopped.reason, self._elapsed_s()
        return EndRecord(reason, best.candidate, best.digest, before, after, elapsed_s)

    def _identify(
        self, pending: PendingGeneration, best: EvaluationRecord, evaluation: "_GenerationRun"
    ) -> None:
        """Find out what the image tells of the constants, from the tangents at the best one."""
        reason = organ_named(self.spec.case.organ).no_derivatives
        if best.fit is not None:
            self._append(IdentificationRecord(best.candidate, best.fit))
        elif reason:
            self._append(IdentificationRecord(best.candidate, None, reason))
        else:
            ending = evaluation.differentiate(pending, best.candidate)
            if ending.kind == "lost":  # of its workers; the next run tries again
                return
            fit = (ending.value or {}).get("fit")
            why = "" if fit else ending.reason or "the simulation with tangents gave none"
            self._append(IdentificationRecord(best.candidate, fit, why))

    def _append(
        self, record: SessionRecord | GenerationRecord | IdentificationRecord | EndRecord
    ) -> None:
        self.journal.append(record.to_json())

    def _elapsed_s(self) -> float:
        return time.monotonic() - self.began


class _GenerationRun:
    """Evaluates the candidates of a run's generations on the cluster."""

    def __init__(self, run: _Run, work: StudyWork) -> None:
        self.run, self.work = run, work
        self.spec, self.tasks, self.hooks = run.spec, run.tasks, run.hooks
        self.store, self.dispatcher, self.endings = run.store, run.dispatcher, run.endings

    def evaluate(self, pending: PendingGeneration) -> None:
        """See that every candidate of a generation has an ending."""
        sharing: dict[str, list[int]] = {}  # equal candidates have one evaluation
        requests: dict[str, EvaluationRequest] = {}
        for candidate in pending.candidates:
            if candidate in self.endings:
                pending.check(self.endings[candidate])
                self.hooks.evaluation_ended(self.endings[candidate], True)
                continue
            request = self._request(pending, candidate)
            sharing.setdefault(request["digest"], []).append(candidate)
            requests[request["digest"]] = request
        calls = []
        for name, candidates in sharing.items():
            stored = load_evaluation(self.store, name)
            if stored is None:
                calls.append((name, (requests[name],)))
            else:
                ending = Ending(name, "returned", stored)
                self._journal(pending, candidates, ending, reused=True)
        lost = []
        crashed = []  # are not journalled while nothing but crashes has come
        others = self._has_other_endings(pending)
        for ending in self.dispatcher.run(self.tasks.evaluate, calls):
            if ending.kind == "lost":
                lost.append(ending)
                blame_cluster_if_many(lost, len(calls))
            elif ending.kind == "crashed" and not others:
                crashed.append(ending)
            else:
                others = True
                for earlier in [*crashed, ending]:
                    self._journal(pending, sharing[earlier.key], earlier, reused=False)
                crashed.clear()
        if not lost:
            refuse_if_all_crashed(crashed, pending.number)
        for ending in [*crashed, *lost]:
            self._journal(pending, sharing[ending.key], ending, reused=False)

    def _has_other_endings(self, pending: PendingGeneration) -> bool:
        """Return whether a candidate of a generation has ended otherwise than in a crash.

        One that an earlier generation had already says nothing of this one.
        """
        earlier = {r.digest for r in self.endings.values() if r.generation < pending.number}
        ended = [self.endings[c] for c in pending.candidates if c in self.endings]
        return any(r.status is not Status.CRASHED and r.digest not in earlier for r in ended)

    def keep_volumes(self, pending: PendingGeneration, generation: Generation) -> None:
        """Store the deformed volumes that the study file asks to keep."""
        if self.spec.keep == "best":
            return
        count = len(generation.scores) if self.spec.keep == "all" else self.spec.search.elite
        kept = [pending.first + int(index) for index in generation.ranking[:count]]
        self.make_volumes(pending, [c for c in kept if pending.carried_from(c) is None])

    def make_volumes(self, pending: PendingGeneration, candidates: list[int]) -> None:
        """Store the deformed volumes of candidates, made from fields that are stored."""
        calls = []
        for candidate in candidates:
            ending = self.endings[candidate]
            if ending.status is Status.DONE and not has_volume(self.store, ending.digest):
                calls.append((candidate, (self._request(pending, candidate),)))
        self.dispatcher.all(self.tasks.keep_volume, calls)

    def differentiate(self, pending: PendingGeneration, candidate: int) -> Ending:
        """Evaluate a candidate once more, with derivatives."""
        request = self._request(pending, candidate, derivatives=True)
        calls = [(request["digest"], (request,))]
        (ending,) = self.dispatcher.run(self.tasks.evaluate, calls)
        return ending

    def findings(self, pending: PendingGeneration, candidate: int) -> Mapping[str, Any]:
        """Find out what the body of a candidate tells beside its constants."""
        return self.dispatcher.call(self.tasks.find, self._request(pending, candidate))

    def _journal(
        self, pending: PendingGeneration, candidates: list[int], ending: Ending, *, reused: bool
    ) -> None:
        """Write down an ending for all candidates that share it, then tell the observers."""
        records = [
            evaluation_record(pending, candidate, ending, reused or position > 0)
            for position, candidate in enumerate(candidates)
        ]
        self.run.journal.append(*(record.to_json() for record in records))
        for record in records:
            self.endings[record.candidate] = record
            self.hooks.evaluation_ended(record, False)

    def _request(
        self, pending: PendingGeneration, candidate: int, *, derivatives: bool = False
    ) -> EvaluationRequest:
        proposal = pending.proposal
        wanted = derivatives or proposal.derivatives
        return self.work.request(pending.genes(candidate), proposal.level, derivatives=wanted)
