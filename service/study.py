"""The loop: ask, dispatch, journal, tell.

Running a study and resuming it are the same: the journal says which candidates
have an ending, the search proposes what it proposed before, and what has no
ending is asked for. Scores are told in the order of the candidates, so neither
the number of workers nor an interruption changes what is proposed next.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from service.chronicle import Chronicle, End, GenerationMark, Session, mark_to_json
from service.course import Course, Step, score_of
from service.dispatch import Dispatcher, Ending
from service.errors import ClusterError
from service.folder import StudyFolder
from service.hooks import Hooks, Observer, StudyFacts
from service.search.base import Generation, Stopped
from service.spec import StudySpec
from service.versions import versions
from storage.evaluations import load_evaluation
from storage.journal import Journal
from storage.records import EvaluationRecord
from storage.status import Status
from storage.stores import Store, open_store
from storage.volumes import has_volume
from workers import tasks as physics

Record = dict[str, Any]
LOST_SHARE = 0.2


@dataclass(frozen=True)
class Tasks:
    """What is sent to the workers; see `workers.tasks` for what each must do."""

    prepare: Callable[..., Record] = physics.prepare_case
    target: Callable[..., Record] = physics.make_target
    evaluate: Callable[..., Record] = physics.evaluate
    digest: Callable[..., str] = physics.evaluation_digest
    keep_volume: Callable[..., Any] = physics.keep_volume
    compare: Callable[..., Record] = physics.score_volumes


@dataclass(frozen=True)
class Conclusion:
    """How a search ended: why, with which best candidate, and all its generations."""

    reason: str
    best: EvaluationRecord | None
    history: tuple[Generation, ...]


class Study:
    """One study and its folder.

    Parameters
    ----------
    spec : StudySpec
        What was asked.
    folder : Path
        Made when missing; continued when it holds this study.
    store : str or Path, optional
        Where volumes and evaluations go. Default: that of the last run, else the
        folder ``store`` beside `folder`.
    tasks : Tasks
        What is sent to the workers.
    observers : iterable of Observer
        Are told what happens.
    accept_new_code : bool
        Continue although the code has changed since the last run.

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
        store: str | Path | None = None,
        *,
        tasks: Tasks | None = None,
        observers: Iterable[Observer] = (),
        accept_new_code: bool = False,
    ) -> None:
        self.spec = spec
        self.tasks = tasks or Tasks()
        self.hooks = Hooks(observers)
        self.folder = StudyFolder(folder, spec, accept_new_code=accept_new_code)
        self.ended = self.folder.check().end is not None
        self._wanted_store = store

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
            told = self.folder.begin(journal)
            store = open_store(self._wanted_store or self.folder.default_store(told))
            return _Run(self, journal, told, store, dispatcher).go(dashboard)


class _Run:
    """One run of a study, its journal locked."""

    def __init__(
        self, study: Study, journal: Journal, told: Chronicle, store: Store, dispatcher: Dispatcher
    ) -> None:
        self.study, self.spec, self.tasks, self.hooks = study, study.spec, study.tasks, study.hooks
        self.journal, self.told, self.store, self.dispatcher = journal, told, store, dispatcher
        self.began = time.monotonic()
        self.endings = dict(told.endings)
        self.replayed = frozenset(told.endings)
        self.case = self.spec.case.model_dump(mode="json")
        self.score = self.spec.score.model_dump(mode="json")
        self.steps: list[Step] = []
        self.prepared: Record = {}
        self.target: Record = {}

    def go(self, dashboard: str) -> Conclusion:
        settings = self.spec.search.settings
        workers = self.dispatcher.threads
        self.hooks.started(
            StudyFacts(
                self.spec.name, str(self.study.folder.root), settings.most_evaluations,
                settings.generations, workers, dashboard,
            )
        )  # fmt: skip
        self._prepare(workers)
        course = Course(self.spec.search_strategy, self.spec.search.space.names)
        while isinstance(step := course.next(), Step):
            self.steps.append(step)
            self._evaluate(step)
            generation = course.close(step, self.endings)
            self._keep_volumes(step, generation)
            if not self.replayed.issuperset(step.candidates):
                best = float(generation.scores.min())
                self._mark(GenerationMark(step.number, best, self._elapsed()))
            self.hooks.generation_ended(step.number, generation)
        return self._conclude(step, course)

    def _prepare(self, workers: int) -> None:
        """Bring case and target into the store, which is quick when they are there."""
        store = str(self.store.root)
        self.prepared = self.dispatcher.call(self.tasks.prepare, self.case, store)
        self.hooks.prepared("case", self.prepared)
        wanted = self.spec.target.model_dump(mode="json")
        self.target = self.dispatcher.call(self.tasks.target, self.case, wanted, store)
        self.hooks.prepared("target", self.target)
        self.study.folder.check_same(self.told, self.prepared, self.target)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        session = Session(
            now, store, versions(), self.prepared, self.target, workers, self._elapsed()
        )
        self.journal.append(mark_to_json(session))

    def _evaluate(self, step: Step) -> None:
        """See that every candidate of a step has an ending."""
        self.hooks.generation_begun(step.number, step.proposal)
        waiting: dict[str, list[int]] = {}
        requests: dict[str, Record] = {}
        for candidate in step.candidates:
            if candidate in self.endings:
                step.check(self.endings[candidate])
                self.hooks.evaluation_ended(self.endings[candidate], True)
                continue
            request = self._request(step, candidate)
            waiting.setdefault(request["digest"], []).append(candidate)
            requests[request["digest"]] = request
        asks = []
        for name, candidates in waiting.items():
            done = load_evaluation(self.store, name)
            if done is None:
                asks.append((name, (requests[name],)))
            else:
                self._journal(step, candidates, Ending(name, "returned", done), reused=True)
        lost = []
        for ending in self.dispatcher.run(self.tasks.evaluate, asks):
            if ending.kind == "lost":
                lost.append(ending)
                _judge_losses(lost, len(asks))
            else:
                self._journal(step, waiting[ending.key], ending, reused=False)
        for ending in lost:
            self._journal(step, waiting[ending.key], ending, reused=False)

    def _journal(self, step: Step, candidates: list[int], ending: Ending, *, reused: bool) -> None:
        """Write down an ending for all candidates that share it, then tell of it."""
        records = [
            _record(step, candidate, ending, reused or position > 0)
            for position, candidate in enumerate(candidates)
        ]
        self.journal.append(*(record.to_json() for record in records))
        for record in records:
            self.endings[record.candidate] = record
            self.hooks.evaluation_ended(record, False)

    def _request(self, step: Step, candidate: int) -> Record:
        constants = self.spec.constants_of(step.genes(candidate))
        target = self.target["target"]
        name = self.tasks.digest(self.case, self.prepared, target, constants, self.score)
        return {
            "store": str(self.store.root),
            "case": self.case,
            "prepared": self.prepared,
            "target": target,
            "constants": constants,
            "score": self.score,
            "keep_volume": self.spec.keep == "all",
            "digest": name,
        }

    def _keep_volumes(self, step: Step, generation: Generation) -> None:
        """Deformed volumes that the study wants, made from fields that are stored."""
        if self.spec.keep == "best":
            return
        count = len(generation.scores) if self.spec.keep == "all" else self.spec.search.elite
        wanted = [step.first + int(index) for index in generation.ranking[:count]]
        self._make_volumes(step, [c for c in wanted if step.carried_from(c) is None])

    def _make_volumes(self, step: Step, candidates: list[int]) -> None:
        asks = []
        for candidate in candidates:
            ending = self.endings[candidate]
            if ending.status is Status.DONE and not has_volume(self.store, ending.digest):
                asks.append((candidate, (self._request(step, candidate),)))
        self.dispatcher.all(self.tasks.keep_volume, asks)

    def _conclude(self, stopped: Stopped, course: Course) -> Conclusion:
        best = best_of(self.endings)
        history = tuple(course.history)
        if self.told.end is None:
            self._mark(self._end(stopped, best))
        self.hooks.stopped(stopped.reason)
        return Conclusion(stopped.reason, best, history)

    def _end(self, stopped: Stopped, best: EvaluationRecord | None) -> End:
        if best is None:
            return End(stopped.reason, None, None, {}, {}, self._elapsed())
        self._make_volumes(self.steps[best.generation], [best.candidate])
        before, after = (self._compare(volume) for volume in (self.prepared["volume"], best.digest))
        return End(stopped.reason, best.candidate, best.digest, before, after, self._elapsed())

    def _compare(self, volume: str) -> Record:
        """A volume with the target, tissue by tissue."""
        return self.dispatcher.call(
            self.tasks.compare, str(self.store.root), self.target["target"], volume,
            self.spec.score.surface,
        )  # fmt: skip

    def _mark(self, mark: GenerationMark | End) -> None:
        self.journal.append(mark_to_json(mark))

    def _elapsed(self) -> float:
        return time.monotonic() - self.began


def best_of(endings: Mapping[int, EvaluationRecord]) -> EvaluationRecord | None:
    """The candidate with the lowest score, the first of equals; None if none has one."""
    scored = [endings[c] for c in sorted(endings) if score_of(endings[c]) < math.inf]
    return min(scored, key=score_of, default=None)


def _judge_losses(lost: list[Ending], asked: int) -> None:
    """Where many are lost the cluster is to blame: nothing is said of the candidates."""
    if len(lost) > max(1, LOST_SHARE * asked):
        raise ClusterError(
            f"{len(lost)} of {asked} candidates have lost their workers again and again: "
            f"{lost[0].reason}. The workers may have too little memory: start fewer with "
            "--workers, then run the study again; what is finished is kept."
        )


def _record(step: Step, candidate: int, ending: Ending, reused: bool) -> EvaluationRecord:
    """What the journal says of an ending."""
    who: Record = {
        "candidate": candidate,
        "generation": step.number,
        "genes": step.genes(candidate),
        "digest": ending.key,
        "attempts": max(1, ending.attempts),
        "reused": reused,
    }
    value = ending.value
    if value is None:
        status = Status.CRASHED if ending.kind == "crashed" else Status.LOST
        trace = ending.traceback if status is Status.CRASHED else ""
        return EvaluationRecord(**who, status=status, reason=ending.reason, traceback=trace)
    what: Record = {
        "outcome": value.get("outcome"),
        "seconds": value.get("seconds", {}),
        "worker": value.get("worker", ""),
    }
    score = value.get("score")
    if value["status"] == "done" and score is not None and score["gsf"] < math.inf:
        return EvaluationRecord(**who, **what, status=Status.DONE, score=score)
    reason = value.get("reason") or "it has no score: candidate and target share no tissue compared"
    return EvaluationRecord(**who, **what, status=Status.DIVERGED, reason=reason)
