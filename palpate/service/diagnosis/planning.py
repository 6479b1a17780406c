"""A plan from its source to its summary: simulate every load, and evaluate the results."""

from pathlib import Path

from palpate.service.cluster.dispatch import Dispatcher, value_of
from palpate.service.diagnosis.step import Observer, Step
from palpate.storage.backends.places import Location
from palpate.workers.diagnosis.schema.plan import PlanSummary
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.organs.study_checks import Finding
from palpate.workers.tasks.planning import (
    PlanRequest,
    analyse_load,
    list_loads,
    named,
    weigh_plan,
)
from palpate.workers.tasks.sources import add_source, check_nodes, check_source, open_planned
from palpate.workers.tasks.task_store import TaskStore

NODES = 2000


def request_plan(
    path: Path,
    store: Location,
    nodes: int = NODES,
    spacing_mm: float = SETTINGS.points.spacing_mm,
    *,
    anyway: bool = False,
) -> PlanRequest:
    """Return only the request from `checked_plan`."""
    return checked_plan(path, store, nodes, spacing_mm, anyway=anyway)[0]


def checked_plan(
    path: Path,
    store: Location,
    nodes: int = NODES,
    spacing_mm: float = SETTINGS.points.spacing_mm,
    *,
    anyway: bool = False,
) -> tuple[PlanRequest, list[Finding]]:
    """Read the source into the store, and return the request for the workers.

    Parameters
    ----------
    path : Path
        Folder of a case or of a study.
    store : str or Path
        Created if missing.
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float
        Spacing of points on the interfaces.
    anyway : bool
        Accept implausible inputs.

    Returns
    -------
    request : PlanRequest
    findings : list of Finding
        Findings of the plausibility checks.

    Raises
    ------
    InputError
        If the path cannot be planned.
    StoreError
        If the store cannot be used.
    """
    source = open_planned(path.expanduser().absolute(), store)
    findings = check_source(source, anyway=anyway)
    check_nodes(nodes, source)
    parts = TaskStore(store)
    name = add_source(source, parts)
    return named(PlanRequest(str(parts.store.root), name, nodes, spacing_mm)), findings


def run_plan(request: PlanRequest, dispatcher: Dispatcher, observe: Observer) -> PlanSummary:
    """Plan an acquisition, or continue a plan.

    Raises
    ------
    InputError
        If a planned load cannot be simulated.
    StoreError
        If a worker cannot use the store.
    ClusterError, TaskError
        If the workers cannot do the work; completed work is saved.
    Interrupted
        If the dispatcher is asked to stop.
    """
    loads = dispatcher.call(list_loads, request).loads
    observe(Step("loads", 0, len(loads)))
    calls = [(name, (request, number)) for number, name in enumerate(loads)]
    for done, ending in enumerate(dispatcher.run(analyse_load, calls), start=1):
        record = value_of(ending, f"load {ending.key}")
        observe(Step("loads", done, len(loads), ending.key, record))
    return dispatcher.call(weigh_plan, request)
