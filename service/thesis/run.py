"""Runs the experiments of the thesis, from wherever they stand."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.service.cluster.dispatch import Dispatcher, value_of
from palpate.service.thesis.experiments import Experiment, phases_of
from palpate.service.thesis.search import SearchRun, run_search, search_runs
from palpate.storage.backends.places import Place
from palpate.workers.thesis.scale import Scale


@dataclass(frozen=True)
class ThesisRequest:
    """What is asked.

    Parameters
    ----------
    experiments : sequence of str
    scale : str
    store : Path or ObjectPath
        Where parts go.
    folder : Path
        Where studies and pages go.
    strategy : str
        Of the searches.
    """

    experiments: Sequence[Experiment]
    scale: Scale
    store: Place
    folder: Path
    strategy: str

    @property
    def searches(self) -> list[SearchRun]:
        """Return its searches; none if they are not asked for."""
        if "search" not in self.experiments:
            return []
        return search_runs(self.folder, self.scale, self.strategy)


@dataclass(frozen=True)
class Step:
    """How far an experiment is.

    Parameters
    ----------
    experiment : str
    title : str
        What is being done.
    done, of : int
        Parts of it, candidates where it is a search.
    label : str
        The part that has just ended; empty at the beginning.
    cpu_s : float
        What that part has cost.
    """

    experiment: Experiment
    title: str
    done: int
    of: int
    label: str = ""
    cpu_s: float = 0.0


Observe = Callable[[Step], object]


def run_thesis(request: ThesisRequest, dispatcher: Dispatcher, observe: Observe) -> None:
    """Run all that the store does not have.

    Raises
    ------
    InputError
        If an experiment cannot be run.
    StoreError
        If a worker cannot use the store.
    ClusterError, TaskError
        If the workers cannot do the work; what is finished is kept.
    Interrupted
        If the dispatcher is told to stop.
    """
    store = str(request.store)
    for experiment in request.experiments:
        for phase in phases_of(experiment, store, request.scale):
            missing = phase.missing
            done, of = len(phase.requests) - len(missing), len(phase.requests)
            observe(Step(experiment, phase.title, done, of))
            calls = [(one.label, (one,)) for one in missing]
            for ending in dispatcher.run(phase.task, calls):
                spent = value_of(ending, ending.key)
                done += 1
                observe(Step(experiment, phase.title, done, of, ending.key, spent.cpu_s))
        if experiment == "search":
            for run in request.searches:
                _search(run, request.store, dispatcher, observe)


def _search(run: SearchRun, store: Place, dispatcher: Dispatcher, observe: Observe) -> None:
    if run.is_finished:
        return
    title = f"searching {run.target}, phantom {run.phantom}"

    def counted(search: SearchRun, ended: int) -> None:
        label = f"{ended} candidates" if ended else ""
        observe(Step("search", title, ended, search.most_evaluations, label))

    run_search(run, store, dispatcher, counted)
