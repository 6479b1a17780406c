"""Displacements from constants and loads, by nested iteration from coarse to fine.

The body is solved from rest on the coarsest mesh; each finer one starts from the
coarser solution and takes a few Newton steps, whose linear systems the coarser
levels precondition. Friction depends on the path: the load is then applied in
steps, each of which ends in equilibrium on every mesh. The outcome is taken from the end of the
load path.

Only a body that collapses on the way is solved with a barrier, see
`workers.mechanics.fem.element_laws`.

A body imaged under gravity first needs its stress-free shape. Inverse fixed-point iteration
(Rajagopal et al. 2007; Sellier 2011): load the current guess, and move it by its difference from
the image. It does not depend on the loads, so the last shapes of a body are cached: its scans
share them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from weakref import WeakKeyDictionary

import numpy as np

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem import element_energy
from palpate.workers.mechanics.fem.boundary_value_problem import (
    SQUEEZED_J,
    Outcome,
    Problem,
    Solution,
)
from palpate.workers.mechanics.fem.discretisation import LevelModel, Model, Stage, State, reshaped
from palpate.workers.mechanics.fem.level_equilibrium import equilibrium_fault
from palpate.workers.mechanics.fem.load_path import (
    ConvergedStage,
    LoadPath,
    LoadStepping,
    touching_gap,
)
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates, Wall
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.multigrid import LinearSolver
from palpate.workers.mechanics.fem.plate_contact import PlateContact


def solution_at_end(finest: Level, imaged: LevelModel, path: LoadPath) -> Solution:
    """Return the displacement from the imaged shape, and the outcome."""
    model, stage, state, results = finest.model, path.stage, path.states[-1], path.results
    energy = finest.energy(state, stage)
    lower, upper = energy.plate_forces
    min_j = float(element_energy.smallest_volume_ratio(state.x, model.elements))
    force = finest.force(state, energy, stage)
    reason = path.reason or equilibrium_fault(finest, state, energy, stage, force)
    if min_j <= 0 and not reason:
        reason = "elements are turned inside out"
    if reason:
        reason += _collapsed_tissue(model, state)
    deepest = max((float(p.penetration.max()) for p in energy.plate_contacts), default=0.0)
    sprung = finest.springs * (state.x - model.nodes)
    reaction = (force - sprung)[model.wall, 2].sum()
    return Solution(
        displacement_mm=state.x - imaged.nodes,
        outcome=Outcome(
            converged=not reason,
            reason=reason,
            newton_iterations=tuple(r.iterations for r in results),
            cg_iterations=tuple(r.cg_iterations for r in results),
            residual_n=results[-1].residual_n,
            plate_displacement_mm=_travel_mm(model, stage, state),
            plate_force_n=upper,
            contact_area_mm2=_contact_area_mm2(model, energy.plate_contacts),
            penetration_mm=deepest,
            min_j=min_j,
            energy_mj=energy.elastic,
            force_imbalance=abs(upper - lower) / max(upper, 1e-12),
            wall_force_n=float(reaction),
            squeezed=not reason and min_j < SQUEEZED_J,
        ),
    )


def _collapsed_tissue(model: LevelModel, state: State) -> str:
    """Return a clause on squeezed elements and their main tissue to append to a reason; or ""."""
    ratios = element_energy.volume_ratios(state.x, model.elements)
    collapsed = ratios < SQUEEZED_J
    if not collapsed.any():
        return ""
    lost = model.elements.volumes[collapsed] @ model.fractions[collapsed]
    tissue = Tissue(int(lost.argmax())).name.lower()
    return (
        f"; {collapsed.sum()} of {len(ratios)} elements, most of them {tissue}, are squeezed to "
        f"less than {SQUEEZED_J:g} of their volume (the worst to {ratios.min():.2g})"
    )


def _travel_mm(model: LevelModel, stage: Stage, state: State) -> float:
    """Return the distance by which the plates approached after just touching the body."""
    if stage.force_n is not None:
        return state.travel_mm
    if stage.gap is None:
        return 0.0
    touching = touching_gap(model.nodes, stage.device)
    return (touching.upper_mm - touching.lower_mm) - (stage.gap.upper_mm - stage.gap.lower_mm)


def _contact_area_mm2(model: LevelModel, contacts: Sequence[PlateContact]) -> float:
    """Return the undeformed surface area pressed against the upper plate."""
    if not contacts:
        return 0.0
    stiffness = model.contact_nodes.stiffness
    pressed = stiffness[contacts[-1].gap < 0].sum()
    return float(pressed / stiffness.sum() * model.sheet.area.sum())


MAX_SHAPE_ROUNDS = 60
# Nodes of the stress-free meshes cached for one body, at least one mesh: a diagnosis reuses the
# shapes of eight neighbouring problems for every scan.
KEPT_SHAPE_NODES = 150_000


class NoStressFreeShapeError(Exception):
    """No stress-free shape found: an ordinary end of a simulation, with a reason."""


@dataclass(frozen=True, eq=False)
class _KnownShapes:
    """Last stress-free shapes of one body, each with the problem whose weight deforms it."""

    shapes: list[tuple[Problem, Model]] = field(default_factory=list)
    lock: Lock = field(default_factory=Lock)

    def find(self, hanging: Problem) -> Model | None:
        """Return the cached shape for this problem, if any."""
        return next((rest for known, rest in self.shapes if known == hanging), None)

    def add(self, hanging: Problem, rest: Model) -> None:
        """Cache a shape, and drop the oldest ones if there are too many."""
        self.shapes.append((hanging, rest))
        del self.shapes[: -max(1, KEPT_SHAPE_NODES // len(rest.finest.nodes))]


_known_shapes: WeakKeyDictionary[Model, _KnownShapes] = WeakKeyDictionary()


def stress_free(model: Model, problem: Problem) -> Model:
    """Return the model that has the shape of `model` under `problem.imaged_gravity_g`.

    During imaging the chest wall held the body in every direction and no plate touched it.

    Raises
    ------
    NoStressFreeShapeError
        If no such shape is found.
    InputError
        If a tissue of the mesh has no constants.
    """
    hanging = hanging_problem(problem)
    known = _known_shapes.setdefault(model, _KnownShapes())
    with known.lock:  # a second thread waits for the same shape
        rest = known.find(hanging)
        if rest is None:
            rest = _found_shape(model, hanging, 0.1 * problem.tolerance_mm)
            known.add(hanging, rest)
    return rest


def hanging_problem(problem: Problem) -> Problem:
    """Return the problem of the body during imaging: its weight, held at the chest wall."""
    return replace(
        problem,
        load=NoPlates(),
        wall=Wall(held=(True, True, True)),
        gravity_g=problem.imaged_gravity_g,
        imaged_gravity_g=(0.0, 0.0, 0.0),
        pressures=(),
        forces=(),
        holds=(),
        friction_steps=1,
        tolerance_mm=0.05 * problem.tolerance_mm,
    )


def _found_shape(model: Model, hanging: Problem, tolerance_mm: float) -> Model:
    """Return the stress-free model that gravity deforms into the imaged shape.

    After the first round only the finest mesh is loaded, from the image, and moved; the coarser
    ones supply a start and a preconditioner.
    """
    imaged = [level.nodes for level in model]
    guess, near = list(imaged), None
    for _ in range(MAX_SHAPE_ROUNDS):
        rest = reshaped(model, guess)
        levels = tuple(Level.build(level, hanging) for level in rest)
        path = LoadStepping(rest, hanging, levels).run(near)
        if path.reason:
            raise NoStressFreeShapeError(
                "No stress-free shape was found for imaged_gravity_g = "
                f"{hanging.gravity_g}: {path.reason}."
            )
        missing = [x - s.x for x, s in zip(imaged, path.states, strict=True)]
        if float(np.abs(missing[-1]).max()) < tolerance_mm:
            return rest
        moved = missing if near is None else [*map(np.zeros_like, missing[:-1]), missing[-1]]
        guess = [x + m for x, m in zip(guess, moved, strict=True)]
        near = [_stage_ending_at(path.converged[-1], imaged[-1])]
    raise NoStressFreeShapeError(
        "No stress-free shape was found for imaged_gravity_g = "
        f"{hanging.gravity_g} in {MAX_SHAPE_ROUNDS} rounds: the body is too soft to "
        "carry its weight there."
    )


def _stage_ending_at(stage: ConvergedStage, x: FloatArray) -> ConvergedStage:
    """Return a stage whose finest mesh ends at `x`, (n, 3), as the start of the next one."""
    *coarser, finest = stage.states
    return replace(stage, states=(*coarser, finest.moved_to(x, finest.travel_mm)))


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
    solution = solution_at_end(path.levels[-1], imaged.finest, path)
    if reason:
        outcome = replace(solution.outcome, converged=False, reason=reason)
        solution = replace(solution, outcome=outcome)
    return Equilibrium(
        imaged, model, problem, path.stage, path.levels, path.states, path.converged, solution
    )
