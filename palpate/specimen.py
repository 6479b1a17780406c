"""The forward model of a bench specimen."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.forward.case_keys import stated_in
from palpate.service.forward.simulation import MeshedBody, Simulation
from palpate.storage.errors import InputError
from palpate.workers.mechanics.fem.elements.model import Model, prepare
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.parameters import Parameter, Vocabulary, unknown_name
from palpate.workers.organs.specimen.body import Body
from palpate.workers.organs.specimen.problem import free_constants, problem_of
from palpate.workers.organs.specimen.spec import LoadsSpec, SpecimenSpec, read_spec
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file
from palpate.workers.spec import validated

__all__ = ["Specimen"]


class Specimen:
    """The specimen of a bench experiment, ready to be loaded as in any of its states.

    The recordings that an experiment names are not read.

    Parameters
    ----------
    experiment : str, Path or mapping
        The file of an experiment, or its keys. A mesh file that it names is looked up beside the
        file, or from the working folder.
    nodes : int
        Approximate number of nodes of the mesh, which is made at the first simulation.

    Raises
    ------
    InputError
        Naming every key that makes no sense.
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
        self._body = Body(self.spec, body_of_file(self.spec, folder / mesh)[0] if mesh else None)
        self._nodes = nodes

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, measured ones first."""
        return tuple(one.name for one in (*self.spec.states, *self.spec.predict))

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants that `simulate` needs, units included."""
        return self._vocabulary.door_names

    def simulate(self, state: str, **constants: float) -> Simulation:
        """Load the specimen once.

        Parameters
        ----------
        state : str
            Name of a state of the experiment.
        **constants : float
            All of `constants`: Young's modulus of each material, such as ``E_kpa=200``, and what
            else the experiment states as an interval.

        Raises
        ------
        InputError
            If there is no such state, a region moves in it as was measured, or a constant is
            unknown or missing.
        """
        loads = self._loads(state)
        stated = stated_in(self._vocabulary, constants)
        missing = [p.door_name for p in self._vocabulary if p.name not in stated]
        if missing:
            raise InputError(f"The specimen needs {' and '.join(missing)}: give each a value.")

        def problem(values: Mapping[str, float]) -> Problem:
            return problem_of(self.spec, loads, values, self._body.wall_mm)

        body = MeshedBody(self._model, self._vocabulary, self._vocabulary.complete, problem)
        return body.simulate(stated)

    def _loads(self, state: str) -> LoadsSpec:
        for one in (*self.spec.states, *self.spec.predict):
            if one.name == state:
                if any(move.measured for move in one.moves):
                    raise InputError(
                        f"A region of the state {state} moves as was measured: choose a state "
                        "whose moves all give displacement_mm."
                    )
                found: LoadsSpec = one
                return found
        raise InputError(unknown_name("state", state, self.states))

    @cached_property
    def _model(self) -> Model:
        return prepare(self._body.mesh(self._nodes))

    @cached_property
    def _vocabulary(self) -> Vocabulary:
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
