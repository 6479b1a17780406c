"""Running the experiments of the thesis, from their current state."""

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
        """Return the searches; none if they are not requested."""
        if "search" not in self.experiments:
            return []
        return search_runs(self.folder, self.scale, self.strategy)


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
