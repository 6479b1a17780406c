"""Evaluation of candidates that no search has proposed, such as the rows of a table.

Evaluations in the store are not computed again, whoever requested them first, so an
interrupted batch continues where it stopped. Its progress is one line, updated on a terminal and
repeated every 10 s elsewhere.
"""

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from palpate.service.cluster.task_dispatch import Ending, TaskRunner
from palpate.service.simulation.candidate_tables import Evaluations, Genes, candidates_of
from palpate.service.study.candidate_evaluation import blame_cluster_if_many, ending_record
from palpate.service.study.preflight import preflight, require_plugins, used_plugins
from palpate.service.study.study_events import Hooks, Observer, StudyFacts
from palpate.service.study.study_folder import StudyFolder, StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_progress import FAILED, LINE_EVERY_S, Pace, clock, ended_of, left_s
from palpate.service.study.task_requests import StudyWork, Tasks
from palpate.storage.backends.store_paths import Location, Place, place_of
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.store import load_evaluation, open_store
from palpate.storage.values import EvaluationRequest, PreparedBody, PreparedTarget
from palpate.workers.organs.plausibility_rule import Finding


@dataclass(frozen=True)
class BatchPlan:
    """Candidates of a study and the place of their evaluations.

    Parameters
    ----------
    spec : StudySpec
        The study; its search is not run.
    candidates : tuple of dict
        Checked; see `service.simulation.candidate_tables.candidates_of`.
    store : Path or ObjectPath
    is_checked : bool
        Whether the study has run before, so its inputs have been checked already.
    """

    spec: StudySpec
    candidates: tuple[Genes, ...]
    store: Place
    is_checked: bool

    def check(self, *, anyway: bool = False, elsewhere: bool = False) -> list[Finding]:
        """Check that the study is plausible; see `service.study.preflight.preflight`."""
        if self.is_checked:
            return []
        return preflight(self.spec, self.store, anyway=anyway, elsewhere=elsewhere)


def plan_batch(
    spec: StudySpec, table: Any, folder: Path, store: Location | None = None
) -> BatchPlan:
    """Check a table before any work starts.

    Parameters
    ----------
    spec : StudySpec
    table : mapping, DataFrame, structured array, or sequence of mappings
        See `service.simulation.candidate_tables.candidates_of`.
    folder : Path
        Folder of the study, which need not exist.
    store : Path, ObjectPath or str, optional
        Default: the store of the study's last run, else ``store`` next to the study's folder.

    Raises
    ------
    InputError
        If a value is not valid; the message names its row and column.
    """
    candidates = tuple(candidates_of(spec, table))
    study = StudyFolder(folder, spec, accept_new_code=True)
    log = StudyLog.read(study.layout.journal)
    place = place_of(store or study.default_store(log))
    same = log.study is not None and log.study.spec_digest == spec.digest
    return BatchPlan(spec, candidates, place, same and bool(log.sessions))


def evaluate_batch(
    plan: BatchPlan,
    runner: TaskRunner,
    *,
    observers: Iterable[Observer] = (),
    tasks: Tasks | None = None,
) -> Evaluations:
    """Evaluate candidates as a search of a study would, reusing stored evaluations.

    Parameters
    ----------
    plan : BatchPlan
    runner : TaskRunner
    observers : iterable of Observer
        Called as for a study of one generation.
    tasks : Tasks, optional

    Raises
    ------
    InputError
        If the case or the target is not valid.
    StoreError
        If the store cannot be used.
    ClusterError
        If the workers cannot do the work; completed evaluations are saved.
    Interrupted
        If the runner is asked to stop; completed evaluations are saved.
    """
    hooks, candidates = Hooks(observers), plan.candidates
    work = _prepared(plan, runner, hooks, tasks or Tasks())
    requests: dict[str, EvaluationRequest] = {}
    sharing: dict[str, list[int]] = {}  # equal candidates have one evaluation
    for row, genes in enumerate(candidates):
        request = work.request(genes)
        requests[request["digest"]] = request
        sharing.setdefault(request["digest"], []).append(row)
    records: dict[int, EvaluationRecord] = {}
    hooks.generation_begun(0, len(candidates))

    def write_down(ending: Ending, *, reused: bool) -> None:
        for position, row in enumerate(sharing[ending.key]):
            records[row] = ending_record(
                ending,
                candidate=row,
                generation=0,
                genes=candidates[row],
                reused=reused or position > 0,
            )
            hooks.evaluation_ended(records[row], False)

    calls = []
    for name, request in requests.items():
        stored = None if request["keep_volume"] else load_evaluation(work.store, name)
        if stored is None:
            calls.append((name, work.arguments(request)))
        else:
            write_down(Ending(name, "returned", stored), reused=True)
    lost: list[Ending] = []
    for ending in runner.run(work.evaluate, calls):
        if ending.kind == "lost":
            lost.append(ending)
            blame_cluster_if_many(lost, len(calls))
        write_down(ending, reused=_was_reused(ending.value))
    hooks.stopped("all candidates are evaluated")
    return Evaluations(
        tuple(records[row] for row in range(len(candidates))), plan.spec.objective.name
    )


def _was_reused(result: Mapping[str, Any] | None) -> bool:
    return bool(result and result.get("reused"))


def _prepared(plan: BatchPlan, runner: TaskRunner, hooks: Hooks, tasks: Tasks) -> StudyWork:
    """Prepare case and target in the store; quick if they are already there."""
    store, spec = open_store(plan.store), plan.spec
    facts = StudyFacts(
        name=spec.name,
        folder=str(store.root),
        most_evaluations=len(plan.candidates),
        generations=1,
        workers=runner.threads,
        dashboard="",
        objective=spec.objective,
    )
    hooks.started(facts)
    require_plugins(runner, used_plugins(spec))
    case = spec.case.model_dump(mode="json")
    body = runner.call(tasks.prepare, case, str(store.root))
    hooks.prepared("case", body)
    target = runner.call(tasks.target, case, spec.target.model_dump(mode="json"), str(store.root))
    hooks.prepared("target", target)
    return StudyWork(spec, tasks, store, runner, body, target["target"])


class BatchProgress(Observer):
    """A counter of completed candidates, as an observer and a context manager.

    Parameters
    ----------
    console : rich.console.Console
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.counts: Counter[str] = Counter()
        self.of = self.reused = 0
        self.workers = 1
        self.phase = "starting"
        self._pace = Pace()
        self._last = time.monotonic()
        self._live = Live(console=console, refresh_per_second=2, get_renderable=self._render)

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def started(self, facts: StudyFacts) -> None:
        """Store the number of candidates."""
        self.of, self.workers = facts.most_evaluations, facts.workers
        self.phase = "preparing body and mesh"

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Store the next phase."""
        self.phase = "making the target" if what == "case" else ""

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Count a candidate, and print a line from time to time."""
        self.counts[record.status.value] += 1
        self.reused += record.reused
        if not record.reused:
            self._pace.add(sum(record.seconds.values()))
        if not self.console.is_terminal and time.monotonic() - self._last >= LINE_EVERY_S:
            self._last = time.monotonic()
            self.console.print(self.text, markup=False, highlight=False, soft_wrap=True)

    @property
    def text(self) -> str:
        """The progress of the batch as text."""
        if self.phase:
            return self.phase
        parts = [f"{ended_of(self.counts):,} of {self.of:,} candidates"]
        parts += [f"{self.counts[status]:,} {status}" for status in FAILED if self.counts[status]]
        parts += [f"{self.reused:,} reused"] if self.reused else []
        per_minute = self._pace.per_minute(self.workers)
        if per_minute:
            workers = "1 worker" if self.workers == 1 else f"{self.workers} workers"
            left = clock(left_s(self.counts, self.of, per_minute))
            parts.append(f"{per_minute:.1f} per minute on {workers}, {left} left")
        return "; ".join(parts)

    def _render(self) -> Text:
        return Text(self.text)
