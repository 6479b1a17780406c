"""What a plan sends to Dask: a small record in, a small record out.

::

    list_states     a case or a study    > the loads that are meant, and those that could be added
    foresee_state   one of them          > what its scan will show of constants and effects
    weigh_plan      all of them          > what can be told, and what would tell more

Every task is idempotent: what the store has is not made again.
"""

import time
from pathlib import Path
from typing import Any, TypedDict

from storage.arrays import exists, load_arrays, load_meta, save_arrays
from storage.digest import digest, file_digest
from storage.errors import InputError
from storage.stores import open_store
from workers.diagnosis.subject import Subject
from workers.library import code_version
from workers.planning.acquisition import State, states_of
from workers.planning.foreseen import Foreseen, foresee, ground_of
from workers.planning.prospect import Prospect, prospect_of_case
from workers.planning.summary import plan
from workers.resources import CACHE
from workers.studies import is_study, open_study

Record = dict[str, Any]
NOMINAL = "nominal"
ROOMS = (
    "cases", "diagnosis", "effects", "fem", "images", "materials", "mesh", "observation", "organs",
    "planning",
)  # fmt: skip


class PlanRequest(TypedDict):
    """What is asked of a plan; ``store`` and ``source`` are absolute paths all workers see."""

    store: str
    source: str
    nodes: int
    spacing_mm: float
    name: str


def named(request: PlanRequest) -> PlanRequest:
    """The request under the name of all that its result depends on, the code included.

    Raises
    ------
    InputError
        If the source is neither a case nor a study.
    """
    prospect = open_prospect(Path(request["source"]))
    content = [file_digest(file) for file in prospect.files]
    name = digest(
        "plan", content, request["nodes"], request["spacing_mm"], code_version(*ROOMS)
    )  # fmt: skip
    return {**request, "name": name}


def open_prospect(path: Path) -> Prospect:
    """What is known of an acquisition before its loaded scans.

    Raises
    ------
    InputError
        If `path` is neither the folder of a case nor that of a study.
    """
    if (path / "case.json").is_file():
        return prospect_of_case(path)
    if is_study(path):
        source = open_study(path)
        source.check()
        return source.prospect
    raise InputError(
        f"{path} cannot be planned: expected a folder with case.json and its reference scan, or "
        "the folder of a study that has run."
    )


def list_states(request: PlanRequest) -> Record:
    """The loads that are meant, then those that could be added.

    Returns
    -------
    dict
        ``states``, their names in order; ``points``, how many lie on the interfaces.
    """
    ground, states = _ground(request)
    return {"states": [s.name for s in states], "points": len(ground.points)}


def foresee_state(request: PlanRequest, number: int) -> Record:
    """Simulate one load, and what every effect would do to its scan.

    Returns
    -------
    dict
        ``name``; ``simulated``, whether the nominal model converges; ``travel_mm`` of the
        plates; ``seconds``.
    """
    path = _path(request, "state", number)
    if not exists(path):
        begun = time.perf_counter()
        ground, states = _ground(request)
        state = states[number]
        found = foresee(ground, state.name, state.problem, _prospect(request).effects)
        told: Record = {"name": state.name, "simulated": found is not None}
        told["travel_mm"] = None if found is None else found.travel_mm
        told["seconds"] = time.perf_counter() - begun
        arrays = {} if found is None else {NOMINAL: found.nominal, **found.columns}
        save_arrays(path, arrays, told)
    return load_meta(path)


def weigh_plan(request: PlanRequest) -> Record:
    """What the acquisition can tell, see `workers.planning.summary.plan`.

    Raises
    ------
    InputError
        If a load that is meant cannot be simulated.
    """
    path = _path(request, "summary")
    if not exists(path):
        ground, states = _ground(request)
        foreseen = {
            number: found
            for number in range(len(states))
            if (found := _foreseen(request, number)) is not None
        }
        lost = [s.name for n, s in enumerate(states) if s.kind == "meant" and n not in foreseen]
        if lost:
            raise InputError(
                f"The nominal model does not converge at {', '.join(lost)} in the middle of the "
                "plausible intervals: check loads, units and constants."
            )
        prospect = _prospect(request)
        told = plan(prospect.name, ground, states, foreseen, prospect.effects)
        save_arrays(path, {}, told)
    return load_meta(path)


def stored_plan(request: PlanRequest) -> Record | None:
    """The plan if the store has it."""
    path = _path(request, "summary")
    return load_meta(path) if exists(path) else None


def _foreseen(request: PlanRequest, number: int) -> Foreseen | None:
    arrays, told = load_arrays(_path(request, "state", number))
    if not told["simulated"]:
        return None
    columns = {name: values for name, values in arrays.items() if name != NOMINAL}
    return Foreseen(arrays[NOMINAL], columns, told["travel_mm"])


def _ground(request: PlanRequest) -> tuple[Subject, list[State]]:
    """The body at rest and all loads; made once by each process."""

    def make() -> tuple[Subject, list[State]]:
        prospect = _prospect(request)
        ground = ground_of(prospect, request["nodes"], request["spacing_mm"])
        return ground, states_of(prospect, ground.frame, ground.model.finest.nodes)

    return CACHE.get(("plan", request["store"], request["name"], "ground"), make)


def _prospect(request: PlanRequest) -> Prospect:
    key = ("plan", request["store"], request["name"], "prospect")
    return CACHE.get(key, lambda: open_prospect(Path(request["source"])))


def _path(request: PlanRequest, *which: Any) -> Path:
    return open_store(request["store"]).layout.field(digest("plan", request["name"], *which))
