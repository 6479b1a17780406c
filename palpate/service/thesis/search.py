"""The searches of thesis section 4.5 as studies, each in a separate folder."""

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.results.read import study_results
from palpate.service.results.record import StudyResults
from palpate.service.run_study import Entrance, run_study
from palpate.service.study.log import StudyLog
from palpate.service.study.loop import Study
from palpate.service.study.observers.hooks import Observer, StudyFacts
from palpate.service.study.session import Session
from palpate.service.study.spec import StudySpec
from palpate.service.versions import versions
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.backends.places import Place
from palpate.storage.digest import digest
from palpate.storage.records.record import EvaluationRecord
from palpate.workers.spec import validated
from palpate.workers.thesis.identification import TARGETS, TargetName, bounds_of, case_of, runs_at
from palpate.workers.thesis.scale import Scale

GENETIC, POLISHED = "genetic", "genetic+least-squares"
POPULATION: dict[Scale, int] = {"sketch": 6, "reduced": 30, "full": 84}
GENERATIONS: dict[Scale, int] = {"sketch": 2, "reduced": 12, "full": 15}
ELITE = 2


@dataclass(frozen=True)
class SearchRun:
    """One search of the thesis.

    Parameters
    ----------
    target : str
        X1, X2 or X3.
    phantom : int
    spec : StudySpec
    folder : Path
        Named after the study and the code, so that newer code starts a new study.
    """

    target: TargetName
    phantom: int
    spec: StudySpec
    folder: Path

    @property
    def most_evaluations(self) -> int:
        """Return the number of evaluations without an early stop; elites are not reevaluated."""
        return self.spec.most_evaluations

    @property
    def is_finished(self) -> bool:
        """Return True if the search has ended."""
        return StudyLog.read(StudyLayout(self.folder).journal).end is not None

    @property
    def evaluations(self) -> int:
        """Return the number of candidates with an ending."""
        return len(StudyLog.read(StudyLayout(self.folder).journal).endings)

    def results(self) -> StudyResults | None:
        """Return the results; None if the search has not ended."""
        return study_results(self.folder) if self.is_finished else None


def study_of_run(target: TargetName, phantom: int, scale: Scale, strategy: str) -> StudySpec:
    """Return the study of one search.

    Raises
    ------
    InputError
        If the strategy is unknown.
    """
    search: dict[str, Any] = {
        "parameters": bounds_of(target),
        "strategy": strategy,
        "population": POPULATION[scale],
        "generations": GENERATIONS[scale],
        "elite": ELITE,
        "stall": {"generations": 5, "tolerance": 1e-6},
    }
    record = {
        "name": f"{target}-phantom-{phantom}",
        "case": case_of(target, phantom, scale),
        "target": {"constants": TARGETS[target]},
        "search": search,
        "seed": phantom,
    }
    return validated(StudySpec, record, f"The search of {target}, phantom {phantom}")


def search_runs(folder: Path, scale: Scale, strategy: str) -> list[SearchRun]:
    """Return all searches of a scale, with their folders below `folder`."""
    runs = []
    for target, phantom in runs_at(scale):
        spec = study_of_run(target, phantom, scale, strategy)
        short = digest(spec.digest, versions()["code"])[:8]
        home = folder / "studies" / scale / f"{target}-phantom-{phantom}-{short}"
        runs.append(SearchRun(target, phantom, spec, home))
    return runs


Counted = Callable[[SearchRun, int], object]
"""Called with a search and the number of its candidates that have ended."""


def run_search(run: SearchRun, store: Place, dispatcher: Dispatcher, counted: Counted) -> None:
    """Run or continue one search to its end, without a page."""
    study = Study(run.spec, run.folder, store, observers=[_Counter(run, counted)])
    entrance = Entrance(write_page=lambda folder, quick: None)
    run_study(study, nullcontext(Session(dispatcher)), entrance)


def finished(runs: list[SearchRun]) -> Iterator[tuple[SearchRun, StudyResults]]:
    """Yield the completed searches with their results."""
    for run in runs:
        results = run.results()
        if results is not None:
            yield run, results


class _Counter(Observer):
    def __init__(self, run: SearchRun, counted: Counted) -> None:
        self.run, self.counted, self.ended = run, counted, 0

    def started(self, facts: StudyFacts) -> None:
        self.counted(self.run, 0)

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        self.ended += 1
        self.counted(self.run, self.ended)
