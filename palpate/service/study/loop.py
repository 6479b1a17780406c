"""The loop of a study: propose candidates, evaluate them, save the endings, score generations.

Running a study and resuming it are the same: the journal has the candidates that have ended,
the search repeats its earlier proposals, and candidates without an ending are evaluated.
Scores are passed to the search in the order of the candidates, so neither the number of
workers nor an interruption changes the next proposal.

At the end of a study further evaluations reveal errors in its estimates other than noise. The best
candidate is evaluated once more with derivatives with respect to the nuisance parameters of its
organ, and once on a mesh of another size. `results.identification` uses both for the intervals.
"""

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from palpate.service.cluster.task_dispatch import TaskRunner
from palpate.service.installed_packages import versions
from palpate.service.search.search_interface import Generation, Stopped
from palpate.service.study.candidate_evaluation import EvaluationRun, SteadyRun
from palpate.service.study.preflight import require_plugins, used_plugins
from palpate.service.study.search_replay import PendingGeneration, SearchReplay, replayed
from palpate.service.study.study_events import Hooks, Observer, StudyFacts
from palpate.service.study.study_folder import FINDINGS_OF, StudyFolder, StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.task_requests import StudyWork, Tasks
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import Location, place_of
from palpate.storage.best_candidate import best_of
from palpate.storage.errors import PalpateError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import (
    EndRecord,
    EvaluationRecord,
    GenerationRecord,
    IdentificationRecord,
    ProposalRecord,
    SessionRecord,
)
from palpate.storage.json_digests import dumps, seal, to_plain
from palpate.storage.store import Store, open_store
from palpate.storage.values import EvaluationRequest, FitJson, MeshFit
from palpate.workers.organs.organ_plugins import organ_spec
from palpate.workers.organs.organ_protocol import no_derivatives

# Ratio of the nodes of the other mesh to the study's own.
NODE_RATIO = 3.0
# Above this number of nodes the other mesh is coarser.
MOST_NODES = 150_000


class Lost(Exception):  # noqa: N818 - the study ends without it, and the next run tries again
    """An evaluation that was lost with its workers."""


def nuisance_fit(best: EvaluationRecord, evaluation: EvaluationRun) -> FitJson | None:
    """Return the least-squares problem of the best candidate with the nuisance parameters.

    Raises
    ------
    Lost
        If the evaluation was lost with its workers.
    """
    request = evaluation.work.nuisances_request(best.genes)
    return None if request is None else _error_fit(evaluation, request)


def mesh_fits(best: EvaluationRecord, evaluation: EvaluationRun) -> list[MeshFit]:
    """Return the least-squares problem of the best candidate on another mesh, if there is one.

    Raises
    ------
    Lost
        If the evaluation was lost with its workers.
    """
    nodes = evaluation.work.resolution(None).body["facts"].get("nodes")
    if nodes is None:
        return []
    ratio = NODE_RATIO if NODE_RATIO * nodes <= MOST_NODES else 1 / NODE_RATIO
    try:
        request, facts = evaluation.work.on_other_mesh(best.genes, round(ratio * nodes))
    except PalpateError:  # this body has no other mesh
        return []
    fit = _error_fit(evaluation, request)
    return [] if fit is None else [MeshFit(nodes=int(facts["nodes"]), fit=fit)]


def _error_fit(evaluation: EvaluationRun, request: EvaluationRequest) -> FitJson | None:
    work = evaluation.work
    calls = [(request["digest"], work.arguments(request))]
    (ending,) = evaluation.dispatcher.run(work.evaluate, calls)
    if ending.kind == "lost":
        raise Lost
    fit: FitJson | None = (ending.value or {}).get("fit")
    return fit


@dataclass(frozen=True)
class Conclusion:
    """The outcome of a search.

    Parameters
    ----------
    reason : str
        Why the search stopped.
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
        Created if missing; continued if it holds this study.
    store : str or Path, optional
        Location of volumes and evaluations. Default: the store of the last run, else the
        folder ``store`` next to `folder`.
    tasks : Tasks
        The functions that are sent to the workers.
    observers : iterable of Observer
        Receive the events of the study.
    accept_new_code : bool
        Whether to continue even if the code has changed since the last run.

    Attributes
    ----------
    ended, begun : bool
        Whether the search has stopped; whether body and target have been prepared.
    caveats : tuple of str
        Statements that qualify its results; set before `run`, and recorded with it.
    store : Path or ObjectPath
        Location of volumes and evaluations.

    Raises
    ------
    InputError
        If `folder` holds another study, or other code has run this one.
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
        self.caveats: tuple[str, ...] = ()
        self.store = place_of(store or self.folder.default_store(log))
        self._given_store = store

    def run(self, dispatcher: TaskRunner, dashboard: str = "") -> Conclusion:
        """Run the study to its end, from its current state.

        Raises
        ------
        InputError
            If the case or the target is invalid.
        StoreError
            If the store or journal cannot be used, or the study is already running.
        ClusterError
            If the workers cannot do the work; completed evaluations are saved.
        Interrupted
            If the dispatcher is stopped.
        """
        with self.folder.open() as journal:
            log = self.folder.begin(journal)
            store = open_store(self._given_store or self.folder.default_store(log))
            return _Run(self, journal, log, store, dispatcher).to_the_end(dashboard)


class _Run:
    """One run of a study, with its journal locked."""

    def __init__(
        self, study: Study, journal: Journal, log: StudyLog, store: Store, dispatcher: TaskRunner
    ) -> None:
        self.study, self.spec, self.tasks, self.hooks = study, study.spec, study.tasks, study.hooks
        self.journal, self.log, self.store, self.dispatcher = journal, log, store, dispatcher
        self.began = time.monotonic()
        self.endings = dict(log.endings)
        self.case = self.spec.case.model_dump(mode="json")

    def to_the_end(self, dashboard: str) -> Conclusion:
        self._check_continuation()
        self._announce(dashboard)
        work = self._prepare()
        evaluation = EvaluationRun(work, self.journal, self.hooks, self.endings)
        search = self._search_steadily if self.spec.search.steady else self._search
        stopped, history = search(evaluation)
        best_candidate = best_of(self.endings)
        if best_candidate is not None and self.log.identification is None:
            self._identify(best_candidate, evaluation)
        if self.log.end is None:
            self._append(self._end(stopped, best_candidate, evaluation))
        self.hooks.stopped(stopped.reason)
        return Conclusion(stopped.reason, best_candidate, history)

    def _check_continuation(self) -> None:
        """Replay the journal, so that a changed search is rejected before anything is written."""
        if self.spec.search.steady:
            deque(replayed(self.spec.steady_search, self.log.endings), maxlen=0)
        else:
            replay = SearchReplay(self.spec.search_strategy, self.spec.search.space)
            deque(replay.replay(self.log.endings), maxlen=0)

    def _search(self, evaluation: EvaluationRun) -> tuple[Stopped, tuple[Generation, ...]]:
        """Evaluate one generation after another."""
        search = SearchReplay(self.spec.search_strategy, self.spec.search.space)
        while isinstance(pending := search.propose(), PendingGeneration):
            begun = pending.number in self.log.proposals
            reason = None if begun else self._reason_to_stop()
            if reason is not None:
                return Stopped(reason), tuple(search.history)
            self.hooks.generation_begun(pending.number, len(pending.candidates))
            if not begun:
                self._append(pending.record())
            evaluation.evaluate(pending)
            generation = search.complete(pending, self.endings)
            evaluation.keep_volumes(pending, generation)
            self._generation_ended(
                pending.number, generation, self.log.endings.keys() >= set(pending.candidates)
            )
            evaluation.forget(pending.first)
        return pending, tuple(search.history)

    def _search_steadily(self, evaluation: EvaluationRun) -> tuple[Stopped, tuple[Generation, ...]]:
        """Evaluate without a barrier between generations."""
        search = SteadyRun(
            self.spec.steady_search, evaluation, self._generation_ended, self._reason_to_stop
        )
        found = search.to_the_end(self.log.endings)
        evaluation.keep_best()
        return found

    def _reason_to_stop(self) -> str | None:
        """Return the reason to propose no further candidates; None to continue."""
        stop = self.spec.search.stop
        if stop is not None and stop.hours is not None:
            ran_s = self.log.wall_s(self.journal.last_written) + self._elapsed_s()
            if ran_s >= 3600 * stop.hours:
                return f"the time limit search.stop.hours ({stop.hours:g} h) has been reached"
        return self.hooks.stop_reason

    def _generation_ended(self, number: int, generation: Generation, replayed: bool) -> None:
        if not replayed:
            best = float(generation.scores.min())
            self._append(GenerationRecord(number, best, self._elapsed_s()))
        self.hooks.generation_ended(number, generation)

    def _announce(self, dashboard: str) -> None:
        facts = StudyFacts(
            name=self.spec.name,
            folder=str(self.study.folder.root),
            most_evaluations=self.spec.most_evaluations,
            generations=self.spec.most_generations,
            workers=self.dispatcher.threads,
            dashboard=dashboard,
            objective=self.spec.objective,
        )
        self.hooks.started(facts)

    def _prepare(self) -> StudyWork:
        """Store the case and the target, which is quick if they are already stored."""
        store, workers = str(self.store.root), self.dispatcher.threads
        require_plugins(self.dispatcher, used_plugins(self.spec))
        body = self.dispatcher.call(self.tasks.prepare, self.case, store)
        self.hooks.prepared("case", body)
        target_spec = self.spec.target.model_dump(mode="json")
        target = self.dispatcher.call(self.tasks.target, self.case, target_spec, store)
        self.hooks.prepared("target", target)
        self.study.folder.check_same(self.log, body, target)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        self._append(
            SessionRecord(
                now,
                store,
                versions(),
                body,
                target,
                workers,
                self._elapsed_s(),
                list(self.study.caveats) or None,
                self.log.last_run_s(self.journal.last_written),
            )
        )
        target_name = target["target"]
        return StudyWork(self.spec, self.tasks, self.store, self.dispatcher, body, target_name)

    def _end(
        self, stopped: Stopped, best: EvaluationRecord | None, evaluation: EvaluationRun
    ) -> EndRecord:
        if best is None:
            return EndRecord(stopped.reason, None, None, {}, {}, self._elapsed_s())
        evaluation.make_volumes([best.candidate])
        work = evaluation.work
        resolution = work.resolution(best.level)
        before = work.compare_with_target(resolution, resolution.body["volume"])
        after = work.compare_with_target(resolution, best.digest)
        findings = {**evaluation.findings(best.candidate), FINDINGS_OF: best.digest}
        write_file(self.study.folder.layout.findings, seal(dumps(to_plain(findings))).encode())
        reason, elapsed_s = stopped.reason, self._elapsed_s()
        return EndRecord(reason, best.candidate, best.digest, before, after, elapsed_s)

    def _identify(self, best: EvaluationRecord, evaluation: EvaluationRun) -> None:
        """Compute the identifiability of the constants from the derivatives at the best point."""
        organ = self.spec.case.organ
        differentiable = organ_spec(organ).has_derivatives
        reason = "" if differentiable else no_derivatives(organ)
        fit = best.fit
        if fit is None and differentiable:
            ending = evaluation.differentiate(best.candidate)
            if ending.kind == "lost":  # with its workers; the next run tries again
                return
            fit = (ending.value or {}).get("fit")
            reason = "" if fit else ending.reason or "the simulation computed no derivatives"
        try:
            self._append(self._identified(best, fit, reason, evaluation))
        except Lost:  # the next run tries again
            return

    def _identified(
        self, best: EvaluationRecord, fit: FitJson | None, reason: str, evaluation: EvaluationRun
    ) -> IdentificationRecord:
        """Return the record with the other error sources, at the study's own resolution."""
        if fit is None or best.level is not None:
            return IdentificationRecord(best.candidate, fit, reason)
        nuisances = nuisance_fit(best, evaluation)
        meshes = mesh_fits(best, evaluation) or None
        return IdentificationRecord(best.candidate, fit, "", nuisances, meshes)

    def _append(
        self,
        record: SessionRecord
        | ProposalRecord
        | GenerationRecord
        | IdentificationRecord
        | EndRecord,
    ) -> None:
        self.journal.append(record.to_json())

    def _elapsed_s(self) -> float:
        return time.monotonic() - self.began
