"""A body of a study, solved again so that its whole solution can be exported."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from palpate.storage.errors import InputError
from palpate.storage.records.tasks import SpecJson
from palpate.storage.stores.store import open_store
from palpate.storage.values import FloatArray, Volume
from palpate.workers.mechanics.fem.equilibrium.element_fields import ElementFields, element_fields
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.linear.level import Level
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.tasks.body_store import BodyStore
from palpate.workers.tasks.evaluation import case_of, case_organ, make_target, prepare_case
from palpate.workers.tasks.pipeline import Setup


@dataclass(frozen=True, eq=False)
class SolvedBody:
    """A body in equilibrium.

    Parameters
    ----------
    title : str
        Body and constants, for the header of a file.
    setup : Setup
    constants : mapping of str to float
        All parameters, in internal names and units.
    solved : Equilibrium
    """

    title: str
    setup: Setup
    constants: Mapping[str, float]
    solved: Equilibrium

    @property
    def level(self) -> Level:
        """Return the finest mesh with its problem."""
        return self.solved.levels[-1]

    @property
    def positions_mm(self) -> FloatArray:
        """Return the positions of the nodes, shape (n, 3)."""
        return self.solved.states[-1].x

    @property
    def displacement_mm(self) -> FloatArray:
        """Return the displacements from the imaged shape, shape (n, 3)."""
        return self.solved.solution.displacement_mm

    @cached_property
    def fields(self) -> ElementFields:
        """Return stress and strain."""
        return element_fields(self.level, self.positions_mm)

    def deformed_labels(self) -> Volume:
        """Return the deformed body as labelled voxels."""
        organ = self.setup.organ
        deformed = organ.deform(self.setup.body, self.setup.mesh, self.displacement_mm)
        return organ.picture(deformed)

    def under(self, problem: Problem) -> "SolvedBody":
        """Return the same body, solved for another problem.

        Raises
        ------
        InputError
            If the simulation does not converge.
        """
        return replace(self, solved=_solve(self.setup, problem))


def solve_body(
    case: SpecJson,
    constants: Mapping[str, float],
    store: str,
    title: str,
    target: SpecJson | None = None,
) -> SolvedBody:
    """Solve the body of a case under its load.

    Parameters
    ----------
    case : mapping
        In the format of `CaseSpec`.
    constants : mapping of str to float
        In internal names and units; missing ones are taken from the case.
    store : str
        Location of the store, which keeps body and mesh.
    title : str
    target : mapping, optional
        In the format of `TargetSpec`. Plates at a given distance are placed as in an imaged target.

    Raises
    ------
    InputError
        If the simulation does not converge, or the organ has no tetrahedra.
    """
    spec = case_of(case)
    prepared = prepare_case(case, store)
    digests = {"volume": prepared["volume"], "mesh": prepared["mesh"]}
    imaged = target is not None and target.get("constants") is None
    shown = make_target(case, target, store)["target"] if target and imaged else None
    setup = BodyStore(open_store(store), case_organ(case)).setup(spec, digests, shown)
    values = spec.complete(constants)
    problem: Any = setup.organ.problem(
        setup.model, spec, values, setup.landmarks, setup.target_landmarks
    )
    if not isinstance(problem, Problem):
        raise InputError(
            f"A {spec.organ} cannot be exported: expected a body of tetrahedra, such as a breast."
        )
    return SolvedBody(title, setup, values, _solve(setup, problem))


def _solve(setup: Setup, problem: Problem) -> Equilibrium:
    solved = equilibrium(setup.model, problem)
    outcome = solved.solution.outcome
    if not outcome.converged:
        raise InputError(
            f"There is nothing to export because the simulation diverged: {outcome.reason}. "
            "Choose other constants, a smaller load or another mesh."
        )
    return solved
