"""Stress-free shape of a body imaged under gravity.

Inverse fixed-point iteration (Rajagopal et al. 2007; Sellier 2011): load the current guess, and
move it by its difference from the image. It does not depend on the loads, so the last shapes of a
body are cached: its scans share them.
"""

from dataclasses import dataclass, field, replace
from threading import Lock
from weakref import WeakKeyDictionary

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.model import Model, reshaped
from palpate.workers.mechanics.fem.equilibrium.load_stepping import ConvergedStage, LoadStepping
from palpate.workers.mechanics.fem.linear.level import Level
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.loads import NoPlates, Wall

MAX_ROUNDS = 60
# Nodes of the stress-free meshes cached for one body, at least one mesh: a diagnosis reuses the
# shapes of eight neighbouring problems for every scan.
KEPT_NODES = 150_000


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
        del self.shapes[: -max(1, KEPT_NODES // len(rest.finest.nodes))]


_known: WeakKeyDictionary[Model, _KnownShapes] = WeakKeyDictionary()


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
    known = _known.setdefault(model, _KnownShapes())
    with known.lock:  # a second thread waits for the same shape
        rest = known.find(hanging)
        if rest is None:
            rest = _found(model, hanging, 0.1 * problem.tolerance_mm)
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


def _found(model: Model, hanging: Problem, tolerance_mm: float) -> Model:
    """Return the stress-free model that gravity deforms into the imaged shape.

    After the first round only the finest mesh is loaded, from the image, and moved; the coarser
    ones supply a start and a preconditioner.
    """
    imaged = [level.nodes for level in model]
    guess, near = list(imaged), None
    for _ in range(MAX_ROUNDS):
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
        near = [_ending_at(path.converged[-1], imaged[-1])]
    raise NoStressFreeShapeError(
        "No stress-free shape was found for imaged_gravity_g = "
        f"{hanging.gravity_g} in {MAX_ROUNDS} rounds: the body is too soft to "
        "carry its weight there."
    )


def _ending_at(stage: ConvergedStage, x: FloatArray) -> ConvergedStage:
    """Return a stage whose finest mesh ends at `x`, (n, 3), as the start of the next one."""
    *coarser, finest = stage.states
    return replace(stage, states=(*coarser, finest.moved_to(x, finest.travel_mm)))
