"""Displacements from constants and loads, by nested iteration from coarse to fine.

The body is solved from rest on the coarsest mesh; each finer one starts from the
coarser solution and takes a few Newton steps, whose linear systems the coarser
levels precondition. Friction depends on the path: the load is then applied in
steps, each of which ends in equilibrium on every mesh.

Only a body that collapses on the way is solved with a barrier, see
`workers.mechanics.fem.elements.barrier`.
"""

from dataclasses import dataclass, replace

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.equilibrium.load_stepping import ConvergedStage, LoadStepping
from palpate.workers.mechanics.fem.equilibrium.solution_report import report
from palpate.workers.mechanics.fem.equilibrium.stress_free_shape import (
    NoStressFreeShapeError,
    stress_free,
)
from palpate.workers.mechanics.fem.linear.level import Level
from palpate.workers.mechanics.fem.linear.multigrid import LinearSolver
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.outcome import Solution


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Levels of a body at the end of its loading, coarse to fine.

    Parameters
    ----------
    imaged, model : Model
        With the imaged shape, and with the stress-free shape if that differs.
    problem : Problem
    stage : Stage
    levels : tuple of Level
    states : tuple of State
    path : tuple of ConvergedStage
        Converged stages of the load.
    solution : Solution
    """

    imaged: Model
    model: Model
    problem: Problem
    stage: Stage
    levels: tuple[Level, ...]
    states: tuple[State, ...]
    path: tuple[ConvergedStage, ...]
    solution: Solution

    @property
    def solvers(self) -> tuple[LinearSolver, ...]:
        """Linear solvers of the last stage, one for each level, at its last tangent."""
        return self.path[-1].solvers

    def expecting(self, moved_mm: FloatArray) -> "Equilibrium":
        """Return a start for a problem whose nodes move about `moved_mm`, (n, 3), further.

        `moved_mm` may be the tangents times a change in the problem. With several stages, whose
        paths are unknown, the equilibrium is returned unchanged.
        """
        if len(self.path) != 1:
            return self
        return replace(self, path=(replace(self.path[0], expected_mm=moved_mm),))


def solve(model: Model, problem: Problem) -> Solution:
    """Load the body.

    Parameters
    ----------
    model : Model
        Prepared mesh hierarchy; the result is for its finest level.
    problem : Problem
        Constants, loads and boundary conditions.

    Returns
    -------
    Solution
        Displacement of the finest nodes in mm and the outcome. A simulation that
        does not converge is an outcome, not an error; its displacement is the
        last state reached, prolonged to the finest mesh.

    Raises
    ------
    InputError
        If a tissue of the mesh has no constants.
    """
    return equilibrium(model, problem).solution


def equilibrium(model: Model, problem: Problem, start: Equilibrium | None = None) -> Equilibrium:
    """Load the body and keep levels, states and linear solvers for further solves.

    Parameters
    ----------
    model, problem : Model and Problem
        See `solve`.
    start : Equilibrium, optional
        Equilibrium of a similar problem on the same model. Newton's method starts from it
        on the finest mesh, with friction along its whole path; if that fails, or with
        pressure, the body is solved from rest.

    Raises
    ------
    InputError
        If a tissue of the mesh has no constants.
    """
    imaged, reason = model, ""
    if any(problem.imaged_gravity_g):
        try:
            model = stress_free(model, problem)
        except NoStressFreeShapeError as error:
            reason = str(error)
    levels = tuple(Level.build(m, problem) for m in model)
    neighbour = None if start is None or problem.pressures else start.path
    stepping = LoadStepping(model, problem, levels)
    if start is not None and start.levels[-1].barrier is not None:
        stepping = stepping.with_barrier()
    path = stepping.run(neighbour)
    solution = report(path.levels[-1], imaged.finest, path)
    if reason:
        outcome = replace(solution.outcome, converged=False, reason=reason)
        solution = replace(solution, outcome=outcome)
    return Equilibrium(
        imaged,
        model,
        problem,
        path.stage,
        path.levels,
        path.states,
        path.converged,
        solution,
    )
