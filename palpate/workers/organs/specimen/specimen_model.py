"""The model of a bench specimen: its mesh, the constants that vary, and the loads of its states."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.model_parameters import Parameter, Vocabulary, unknown_name
from palpate.workers.organs.specimen.specimen_body import body_of
from palpate.workers.organs.specimen.specimen_keys import LoadsSpec, SpecimenSpec
from palpate.workers.organs.specimen.specimen_problem import free_constants, problem_of


class SpecimenModel:
    """A specimen, ready for the loads of any of its states.

    Parameters
    ----------
    spec : SpecimenSpec or mapping
        The experiment, or its keys.
    voxels : Volume or None
        The body of a mesh file; None for a block or a sheet.
    nodes : int
        Approximate number of nodes of the mesh, which is generated on first use.
    """

    def __init__(self, spec: Any, voxels: Volume | None, nodes: int) -> None:
        self.spec: Any = validated(SpecimenSpec, spec, "The experiment")
        self.voxels = voxels
        self.nodes = nodes
        self._body = body_of(self.spec, voxels)

    def loads(self, state: str) -> LoadsSpec:
        """Return the loads of a state.

        Raises
        ------
        InputError
            If it is unknown, or a region has a measured motion in that state.
        """
        for loads in (*self.spec.states, *self.spec.predict):
            if loads.name == state:
                if any(move.measured for move in loads.moves):
                    raise InputError(
                        f"A region of the state {state} has a measured motion: choose a state "
                        "whose moves all give displacement_mm."
                    )
                chosen: LoadsSpec = loads
                return chosen
        names = tuple(loads.name for loads in (*self.spec.states, *self.spec.predict))
        raise InputError(unknown_name("state", state, names))

    def problem(self, loads: LoadsSpec, constants: Mapping[str, float]) -> Problem:
        """Return the problem for all constants, in internal names and units."""
        return problem_of(self.spec, loads, constants, self._body.wall_mm)

    def solve(self, state: str, constants: Mapping[str, float]) -> Any:
        """Return displacement and outcome; see `workers.organs.organ_protocol.Solution`."""
        problem = self.problem(self.loads(state), self.vocabulary.complete(constants))
        return self._body.forward(()).equilibrium(self.mesh, problem).solution

    @cached_property
    def mesh(self) -> Any:
        """The mesh, prepared for the solver."""
        return self._body.model(self.nodes)

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """The constants that vary."""
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
