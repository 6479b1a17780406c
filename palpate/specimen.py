"""The forward model of a bench specimen."""

import warnings
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.service.cluster.worker_failures import prepare_workers
from palpate.service.simulation.body_simulation import MeshedBody, Simulation
from palpate.service.simulation.organ_simulation import stated_in
from palpate.service.simulation.sheet_simulation import LoadedSheet, SheetSimulation
from palpate.storage import values
from palpate.storage.errors import InputError
from palpate.storage.json_digests import digest
from palpate.storage.store import load_evaluation, save_evaluation
from palpate.storage.stored_arrays import load_field, save_field
from palpate.storage.values import EvaluationResult
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.model_parameters import Parameter, Vocabulary, unknown_name
from palpate.workers.organs.specimen.specimen_body import body_of
from palpate.workers.organs.specimen.specimen_keys import LoadsSpec, SpecimenSpec, read_spec
from palpate.workers.organs.specimen.specimen_problem import free_constants, problem_of
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file
from palpate.workers.resources import worker_name
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.diagnosis_store import plugged_modules
from palpate.workers.tasks.pipeline import Watch
from palpate.workers.tasks.task_store import TaskStore

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Specimen"]

# Code that a simulation depends on: statement, mesh and solution of the problem.
_PHYSICS = (
    "palpate.workers.organs.specimen.specimen_problem",
    "palpate.workers.organs.specimen.specimen_body",
    "palpate.workers.mechanics.fem.discretisation",
    "palpate.workers.mechanics.fem.body_equilibrium",
)


class Specimen:
    """The specimen of a bench experiment, ready for the loads of any of its states.

    The recordings of the experiment are not read.

    Parameters
    ----------
    experiment : str, Path or mapping
        The file of an experiment, or its keys. The path of a mesh file is relative to the file,
        or to the working folder.
    nodes : int
        Approximate number of nodes of the mesh, which is generated for the first simulation.

    Raises
    ------
    InputError
        If a key is not valid; the message names each one.
    """

    def __init__(self, experiment: str | Path | Mapping[str, Any], *, nodes: int = 5000) -> None:
        is_keys = isinstance(experiment, Mapping)
        self.spec: Any = (
            validated(SpecimenSpec, experiment, "The experiment")
            if isinstance(experiment, Mapping)
            else read_spec(Path(experiment))
        )
        folder = Path() if is_keys else Path(str(experiment)).parent
        mesh = self.spec.body.mesh
        voxels, notes = body_of_file(self.spec, folder / mesh) if mesh else (None, ())
        for text in notes:
            warnings.warn(text, stacklevel=2)
        self._bench = _Bench(self.spec, voxels, nodes)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, measured ones first."""
        return tuple(one.name for one in (*self.spec.states, *self.spec.predict))

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants that `simulate` needs, units included."""
        return self._bench.vocabulary.door_names

    def simulate(
        self,
        state: str,
        *,
        client: "Client | None" = None,
        store: str | Path = "runs/store",
        **constants: float,
    ) -> Simulation | SheetSimulation:
        """Load the specimen once; the result of a sheet is a `SheetSimulation`.

        Parameters
        ----------
        state : str
            Name of a state of the experiment.
        client : distributed.Client, optional
            A client with workers for the simulation. Default: this process. Results are stored and
            reused.
        store : str or Path
            Where the workers of `client` find the body of a mesh file and save the result: a
            folder, or ``s3://``, ``gs://`` or ``az://BUCKET/PREFIX``, visible to this process and
            all workers. Not used without a client.
        **constants : float
            All of `constants`: Young's modulus of each material, such as ``E_kpa=200``, and
            everything else that the experiment gives as an interval.

        Raises
        ------
        InputError
            If the state is unknown, a region has a measured motion in that state, or a constant is
            unknown or missing.
        """
        bench, loads = self._bench, _loads_of(self.spec, state)
        stated = stated_in(bench.vocabulary, constants)
        missing = [p.door_name for p in bench.vocabulary if p.name not in stated]
        if missing:
            raise InputError(f"The specimen needs {' and '.join(missing)}: give each a value.")
        body = bench.loaded(loads)
        if client is None:
            return body.simulate(stated)
        kept = TaskStore(store)
        voxels = None if bench.voxels is None else kept.add_volume(bench.voxels)
        prepare_workers(client)
        spec, place = self.spec.model_dump(mode="json"), str(kept.store)
        task = client.submit(
            _simulate_stored, spec, voxels, bench.nodes, state, stated, place, pure=False
        )
        result = task.result()
        displacement_mm = load_field(kept.store, result["digest"])
        return body.result(stated, displacement_mm, result["outcome"])


def _loads_of(spec: Any, state: str) -> LoadsSpec:
    for loads in (*spec.states, *spec.predict):
        if loads.name == state:
            if any(move.measured for move in loads.moves):
                raise InputError(
                    f"A region of the state {state} has a measured motion: choose a state "
                    "whose moves all give displacement_mm."
                )
            chosen: LoadsSpec = loads
            return chosen
    names = tuple(loads.name for loads in (*spec.states, *spec.predict))
    raise InputError(unknown_name("state", state, names))


class _Bench:
    """The mesh of a specimen and the quantities that vary."""

    def __init__(self, spec: SpecimenSpec, voxels: values.Volume | None, nodes: int) -> None:
        self.spec: Any = spec
        self.voxels = voxels
        self.nodes = nodes
        self._body = body_of(spec, voxels)

    def loaded(self, loads: LoadsSpec) -> MeshedBody | LoadedSheet:
        """Return the specimen in one state."""
        kind = MeshedBody if self.spec.body.sheet is None else LoadedSheet

        def problem(constants: Mapping[str, float]) -> Problem:
            return problem_of(self.spec, loads, constants, self._body.wall_mm)

        return kind(self._model, self.vocabulary, self.vocabulary.complete, problem)

    @cached_property
    def _model(self) -> Any:
        return self._body.model(self.nodes)

    @cached_property
    def vocabulary(self) -> Vocabulary:
        return Vocabulary(
            Parameter(
                name=free.name,
                unit=free.unit,
                lower=free.lower,
                upper=free.upper,
                neutral=float(np.exp(free.log_mean)),
                description="",
            )
            for free in free_constants(self.spec)
        )


def _simulate_stored(
    spec: Mapping[str, Any],
    voxels: str | None,
    nodes: int,
    state: str,
    stated: Mapping[str, float],
    location: str,
) -> EvaluationResult:
    """Load a specimen on a worker; store the displacement and return its digest.

    Parameters
    ----------
    spec : mapping
        The keys of the experiment.
    voxels : str or None
        Digest of the body of a mesh file.
    nodes : int
    state : str
    stated : mapping of str to float
        All constants, in internal names and units.
    location : str
        Location of the store.
    """
    kept = TaskStore(location)
    code = code_version(*_PHYSICS, *plugged_modules())
    name = digest("specimen", spec, voxels, nodes, state, dict(stated), code)
    done = load_evaluation(kept.store, name)
    if done is not None:
        return done

    def bench() -> _Bench:
        body = None if voxels is None else kept.volume(voxels)
        return _Bench(validated(SpecimenSpec, spec, "The experiment"), body, nodes)

    made = kept.cached(("specimen", digest(spec, voxels, nodes)), bench)
    watch = Watch()
    with watch.stage("solve"):
        simulation = made.loaded(_loads_of(made.spec, state)).simulate(stated)
    result: EvaluationResult = {
        "digest": name,
        "status": "done" if simulation.converged else "diverged",
        "reason": simulation.reason,
        "outcome": dict(simulation.outcome),
        "constants": dict(stated),
        "seconds": dict(watch.seconds),
        "worker": worker_name(),
    }
    save_field(kept.store, name, simulation.displacement_mm)
    save_evaluation(kept.store, name, result)
    return load_evaluation(kept.store, name) or result
