"""The course of a plan: simulate every load, meant or possible, and weigh what they show."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.dispatch import Dispatcher, Ending
from service.errors import TaskError
from storage.errors import PalpateError
from storage.stores import open_store
from workers import foresee
from workers.cases.build import POINT_SPACING_MM
from workers.foresee import PlanRequest

Json = dict[str, Any]
Tell = Callable[[int, int, Json], None]
"""Told of each load: how many are done, of how many, and what the last task said."""

NODES = 2000


def ask_plan(
    path: Path, store: Path, nodes: int = NODES, spacing_mm: float = POINT_SPACING_MM
) -> PlanRequest:
    """What is asked of the workers; makes the store.

    Parameters
    ----------
    path : Path
        Folder of a case or of a study.
    store : Path
    nodes : int
        Of the mesh.
    spacing_mm : float
        Between points on the interfaces.

    Raises
    ------
    InputError
        If the path cannot be planned.
    StoreError
        If the store cannot be used.
    """
    return foresee.named(
        {
            "store": str(open_store(store).root),
            "source": str(path.expanduser().absolute()),
            "nodes": nodes,
            "spacing_mm": spacing_mm,
            "name": "",
        }
    )


def run_plan(request: PlanRequest, dispatcher: Dispatcher, tell: Tell) -> Json:
    """Plan an acquisition, from wherever it stands.

    Returns
    -------
    dict
        See `workers.planning.summary.plan`.

    Raises
    ------
    InputError
        If a load that is meant cannot be simulated.
    StoreError
        If a worker cannot use the store.
    ClusterError, TaskError
        If the workers cannot do the work; what is finished is kept.
    Interrupted
        If the dispatcher is told to stop.
    """
    states = dispatcher.call(foresee.list_states, request)["states"]
    tell(0, len(states), {})
    asks = [(name, (request, number)) for number, name in enumerate(states)]
    for done, ending in enumerate(dispatcher.run(foresee.foresee_state, asks), start=1):
        tell(done, len(states), _value(ending))
    return dispatcher.call(foresee.weigh_plan, request)


def _value(ending: Ending) -> Json:
    if ending.value is not None:
        return ending.value
    if isinstance(ending.error, PalpateError):
        raise ending.error
    raise TaskError(
        f"The load {ending.key} could not be looked at: {ending.reason}. What is finished is "
        f"kept; the same command continues it.\n{ending.traceback}".rstrip()
    )
