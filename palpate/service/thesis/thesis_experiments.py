"""The experiments of the thesis: their parts in the order of their dependencies, and running them.

::

    coefficients   nine bars > compared; the cylinder
    mesh-quality   meshes; compressions > compared
    mammogram      compressions > mammograms
    search         the searches of section 4.5 as studies, each in a separate folder
    sensitivity    variation of every constant
    cornea         the searches of Table 5.1, as studies

Running continues the experiments from their current state.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from palpate.service.cluster.task_dispatch import Dispatcher, value_of
from palpate.service.installed_packages import versions
from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_from_journal import study_results
from palpate.service.run_study import Entrance, run_study
from palpate.service.study.loop import Study
from palpate.service.study.study_events import Observer, StudyFacts
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.service.study.study_session import Session
from palpate.storage.backends.store_paths import Place, StudyLayout
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.json_digests import digest
from palpate.workers.common_keys import validated
from palpate.workers.tasks.thesis_tasks import (
    Bend,
    Compare,
    ComparePressed,
    Expose,
    Measure,
    Press,
    Request,
    Spent,
    Turn,
    Vary,
    bend_bar,
    compare_bars,
    compare_pressed,
    measure_mesh,
    press_phantom,
    take_mammograms,
    turn_cylinder,
    vary_constant,
)
from palpate.workers.thesis.coefficient_choice import DEFORMATIONS
from palpate.workers.thesis.mesh_quality import MeshKind, kinds_at
from palpate.workers.thesis.phantom_compression import (
    AXES,
    NUMBERS,
    TARGETS,
    LawName,
    Scale,
    TargetName,
    bounds_of,
    case_of,
    runs_at,
)
from palpate.workers.thesis.thesis_eyes import (
    EYE_BOUNDS,
    EYE_ELEMENTS,
    FINER_TARGET,
    TABLE_5_1,
    SyntheticEye,
    case_of_eye,
)

Experiment = Literal["coefficients", "mesh-quality", "mammogram", "search", "sensitivity", "cornea"]
EXPERIMENTS: tuple[Experiment, ...] = get_args(Experiment)
LAWS: tuple[LawName, ...] = get_args(LawName)
PRESSED_ON: tuple[MeshKind, ...] = ("adaptive", "homogeneous")
# Number of values of each constant, evenly spaced over its interval, with the target added.
VALUES: dict[Scale, int] = {"sketch": 3, "reduced": 9, "full": 16}
# The phantom of the sensitivity and of the mesh slices.
SHOWN_PHANTOM = 3

AnyRequest = Any  # a request for the phase's task


@dataclass(frozen=True)
class Phase:
    """Parts that are independent of each other.

    Parameters
    ----------
    title : str
        Description for the user.
    task : callable
        Takes a request, stores the part, returns its cost.
    requests : sequence of Request
    """

    title: str
    task: Callable[[AnyRequest], Spent]
    requests: Sequence[Request]

    @property
    def missing(self) -> list[Request]:
        """Return the parts missing in the store."""
        return [request for request in self.requests if not request.part.is_finished]


def phases_of(experiment: Experiment, store: str, scale: Scale) -> list[Phase]:
    """Return the phases of an experiment in order."""
    make = {
        "coefficients": _coefficients,
        "mesh-quality": _mesh_quality,
        "mammogram": _mammogram,
        "search": lambda *_: [],
        "sensitivity": _sensitivity,
        "cornea": lambda *_: [],
    }[experiment]
    return make(store, scale)


def measured_meshes(store: str, scale: Scale) -> list[Measure]:
    """Return the meshes whose quality is measured."""
    pairs = product(NUMBERS[scale], kinds_at(scale))
    return [Measure(store, scale, number, kind) for number, kind in pairs]


def compressions(store: str, scale: Scale, laws: Sequence[LawName] = LAWS) -> list[Press]:
    """Return the compressions, grouped by mesh."""
    every = product(NUMBERS[scale], PRESSED_ON, laws, AXES)
    return [Press(store, scale, number, mesh, law, view) for number, mesh, law, view in every]


def comparisons(store: str, scale: Scale) -> list[ComparePressed]:
    """Return the comparisons between both meshes."""
    every = product(NUMBERS[scale], LAWS, AXES)
    return [ComparePressed(store, scale, number, law, view) for number, law, view in every]


def exposures(store: str, scale: Scale) -> list[Expose]:
    """Return the mammograms, two views for each phantom."""
    return [Expose(store, scale, n, view) for n, view in product(NUMBERS[scale], AXES)]


def variations(store: str, scale: Scale) -> list[Vary]:
    """Return all values of all constants: four on the model without skin, E_skin with skin."""
    shown: list[tuple[TargetName, str]] = [("X1", name) for name in TARGETS["X1"]]
    shown.append(("X3", "E_skin_kpa"))
    found = []
    for target, constant in shown:
        low, high = bounds_of(target)[constant]
        values = {*np.linspace(low, high, VALUES[scale]).tolist(), TARGETS[target][constant]}
        found += [Vary(store, scale, target, SHOWN_PHANTOM, constant, v) for v in sorted(values)]
    return found


def _coefficients(store: str, scale: Scale) -> list[Phase]:
    bars = [Bend(store, scale, number) for number in (0, *DEFORMATIONS)]
    return [
        Phase("bending the bar", bend_bar, bars),
        Phase("comparing the bars", compare_bars, [Compare(store, scale)]),
        Phase("turning the cylinder", turn_cylinder, [Turn(store, scale)]),
    ]


def _mesh_quality(store: str, scale: Scale) -> list[Phase]:
    return [
        Phase("measuring meshes", measure_mesh, measured_meshes(store, scale)),
        Phase("pressing phantoms", press_phantom, compressions(store, scale)),
        Phase("comparing both meshes", compare_pressed, comparisons(store, scale)),
    ]


def _mammogram(store: str, scale: Scale) -> list[Phase]:
    return [
        Phase("pressing phantoms", press_phantom, compressions(store, scale, ("neo-Hookean",))),
        Phase("taking mammograms", take_mammograms, exposures(store, scale)),
    ]


def _sensitivity(store: str, scale: Scale) -> list[Phase]:
    requests = variations(store, scale)
    return [Phase("varying the constants", vary_constant, requests)]


GENETIC, POLISHED = "genetic", "genetic+least-squares"
POPULATION: dict[Scale, int] = {"sketch": 6, "reduced": 30, "full": 84}
GENERATIONS: dict[Scale, int] = {"sketch": 2, "reduced": 12, "full": 15}
ELITE = 2
# Four Ogden constants lie in a narrow valley, along which derivatives lead.
EYE_POPULATION: dict[Scale, int] = {"sketch": 8, "reduced": 40, "full": 84}
EYE_GENERATIONS: dict[Scale, int] = {"sketch": 2, "reduced": 3, "full": 15}
EYE_STARTS: dict[Scale, int] = {"sketch": 1, "reduced": 3, "full": 3}


@dataclass(frozen=True)
class SearchRun:
    """One search of the thesis.

    Parameters
    ----------
    experiment : {"search", "cornea"}
    target : str
        X1, X2 or X3.
    phantom : int or None
        None for a cornea.
    spec : StudySpec
    folder : Path
        Named after the study and the code, so that newer code starts a new study.
    """

    experiment: Experiment
    target: TargetName
    phantom: int | None
    spec: StudySpec
    folder: Path

    @property
    def title(self) -> str:
        """Return the name of the search."""
        body = "cornea" if self.phantom is None else f"phantom {self.phantom}"
        return f"{self.target}, {body}"

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


def study_of_eye(eye: SyntheticEye, scale: Scale, strategy: str) -> StudySpec:
    """Return the study of one half of Table 5.1; its target has a finer mesh.

    Raises
    ------
    InputError
        If the strategy is unknown.
    """
    search: dict[str, Any] = {
        "parameters": EYE_BOUNDS,
        "strategy": strategy,
        "population": EYE_POPULATION[scale],
        "generations": EYE_GENERATIONS[scale],
        "elite": ELITE,
        "stall": None,
        "starts": EYE_STARTS[scale],
        "fit_evaluations": 40,
    }
    mesh = {"elements": FINER_TARGET * EYE_ELEMENTS[scale]}
    record = {
        "name": f"{eye.name}-cornea",
        "case": case_of_eye(eye, EYE_ELEMENTS[scale]),
        "target": {"constants": eye.target._asdict(), "mesh": mesh},
        "search": search,
        "seed": 1,
    }
    return validated(StudySpec, record, f"The search of {eye.name}, cornea")


def search_runs(folder: Path, scale: Scale, strategy: str) -> list[SearchRun]:
    """Return all searches of a scale, with their folders below `folder`."""
    home = folder / "studies" / scale
    return [
        _run_of("search", target, phantom, study_of_run(target, phantom, scale, strategy), home)
        for target, phantom in runs_at(scale)
    ]


def eye_runs(folder: Path, scale: Scale, strategy: str) -> list[SearchRun]:
    """Return the searches of Table 5.1, with their folders below `folder`."""
    home = folder / "studies" / scale
    return [
        _run_of("cornea", eye.name, None, study_of_eye(eye, scale, strategy), home)
        for eye in TABLE_5_1
    ]


def _run_of(
    experiment: Experiment, target: TargetName, phantom: int | None, spec: StudySpec, home: Path
) -> SearchRun:
    short = digest(spec.digest, versions()["code"])[:8]
    return SearchRun(experiment, target, phantom, spec, home / f"{spec.name}-{short}")


Counted = Callable[[SearchRun, int], object]
"""Called with a search and the number of its candidates that have ended."""


def run_search(run: SearchRun, store: Place, dispatcher: Dispatcher, counted: Counted) -> None:
    """Run or continue one search to its end, without a page."""
    study = Study(run.spec, run.folder, store, observers=[_Counter(run, counted)])
    entrance = Entrance(write_page=lambda folder, quick: None)
    run_study(study, nullcontext(Session(dispatcher)), entrance)


def finished_search(runs: list[SearchRun]) -> Iterator[tuple[SearchRun, StudyResults]]:
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


@dataclass(frozen=True)
class ThesisRequest:
    """The requested experiments and their locations.

    Parameters
    ----------
    experiments : sequence of str
    scale : str
    store : Path or ObjectPath
        Store of the parts.
    folder : Path
        Folder of studies and pages.
    strategy : str
        Strategy of the searches.
    """

    experiments: Sequence[Experiment]
    scale: Scale
    store: Place
    folder: Path
    strategy: str

    @property
    def searches(self) -> list[SearchRun]:
        """Return the searches of all requested experiments."""
        runs = {"search": search_runs, "cornea": eye_runs}
        wanted = [make for experiment, make in runs.items() if experiment in self.experiments]
        return [r for make in wanted for r in make(self.folder, self.scale, self.strategy)]

    def searches_of(self, experiment: Experiment) -> list[SearchRun]:
        """Return the searches of one experiment, if it is requested."""
        return [run for run in self.searches if run.experiment == experiment]


@dataclass(frozen=True)
class Step:
    """The progress of an experiment.

    Parameters
    ----------
    experiment : str
    title : str
        The current activity.
    done, of : int
        Numbers of parts, or of candidates for a search.
    label : str
        The part that has just ended; empty at the start.
    cpu_s : float
        Cost of that part.
    """

    experiment: Experiment
    title: str
    done: int
    of: int
    label: str = ""
    cpu_s: float = 0.0


Observe = Callable[[Step], object]


def run_thesis(request: ThesisRequest, dispatcher: Dispatcher, observe: Observe) -> None:
    """Run all parts missing in the store.

    Raises
    ------
    InputError
        If an experiment cannot be run.
    StoreError
        If a worker cannot use the store.
    ClusterError, TaskError
        If the workers cannot do the work; completed parts are kept.
    Interrupted
        If the dispatcher is stopped.
    """
    store = str(request.store)
    for experiment in request.experiments:
        for phase in phases_of(experiment, store, request.scale):
            missing = phase.missing
            done, of = len(phase.requests) - len(missing), len(phase.requests)
            observe(Step(experiment, phase.title, done, of))
            calls = [(part.label, (part,)) for part in missing]
            for ending in dispatcher.run(phase.task, calls):
                spent = value_of(ending, ending.key)
                done += 1
                observe(Step(experiment, phase.title, done, of, ending.key, spent.cpu_s))
        for run in request.searches_of(experiment):
            _run_searches(run, request.store, dispatcher, observe)


def _run_searches(run: SearchRun, store: Place, dispatcher: Dispatcher, observe: Observe) -> None:
    if run.is_finished:
        return
    title = f"searching {run.title}"

    def counted(search: SearchRun, ended: int) -> None:
        label = f"{ended} candidates" if ended else ""
        observe(Step(run.experiment, title, ended, search.most_evaluations, label))

    run_search(run, store, dispatcher, counted)
