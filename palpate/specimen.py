"""The forward model of a bench specimen."""

import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.service.simulation.body_simulation import Simulation
from palpate.service.simulation.organ_simulation import solved_on, stated_in
from palpate.service.simulation.sheet_simulation import SheetSimulation
from palpate.service.simulation.simulation_record import LoadedModel
from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec, read_spec
from palpate.workers.organs.specimen.specimen_model import SpecimenModel
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file
from palpate.workers.tasks.specimen_tasks import simulate_specimen
from palpate.workers.tasks.task_store import TaskStore

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Specimen"]

# The class of the model, which a worker makes again.
MODEL = f"{SpecimenModel.__module__}:{SpecimenModel.__name__}"


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
        self._model = SpecimenModel(self.spec, voxels, nodes)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, measured ones first."""
        return tuple(one.name for one in (*self.spec.states, *self.spec.predict))

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants that `simulate` needs, units included."""
        return self._model.vocabulary.door_names

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
        model = self._model
        loads, vocabulary = model.loads(state), model.vocabulary
        stated = stated_in(vocabulary, constants)
        missing = [p.door_name for p in vocabulary if p.name not in stated]
        if missing:
            raise InputError(f"The specimen needs {' and '.join(missing)}: give each a value.")
        kind = Simulation if self.spec.body.sheet is None else SheetSimulation
        problem = partial(model.problem, loads)
        loaded: LoadedModel[Any] = LoadedModel(
            kind, model.mesh, vocabulary, vocabulary.complete, problem
        )
        result: Simulation | SheetSimulation
        if client is None:
            result = loaded.simulate(stated)
        else:
            kept = TaskStore(store)
            voxels = None if model.voxels is None else kept.add_volume(model.voxels)
            keys = self.spec.model_dump(mode="json")
            arguments = (MODEL, keys, voxels, model.nodes, state, stated)
            result = loaded.result(
                stated, *solved_on(client, kept.store, simulate_specimen, *arguments)
            )
        return result
