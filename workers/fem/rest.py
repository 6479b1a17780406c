"""The stress-free shape of a body whose image already carries gravity.

The inverse fixed point (Rajagopal et al. 2007; Sellier 2011): load the present
guess, and move it by what is missing to the image.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from workers.fem.loads import NoPlates, Wall
from workers.fem.model import Model, reshaped
from workers.fem.problem import Problem

if TYPE_CHECKING:
    from workers.fem.solve import Equilibrium

MAX_ROUNDS = 60


class NoRestShapeError(Exception):
    """No stress-free shape was found: an ordinary ending of a simulation, with a reason."""


def stress_free(
    model: Model,
    problem: Problem,
    equilibrium: Callable[[Model, Problem], "Equilibrium"],
) -> Model:
    """The model whose shape under `problem.imaged_gravity_g` is that of `model`.

    While the image was taken the chest wall held the body in every direction and
    no plate touched it.

    Raises
    ------
    NoRestShapeError
        If no such shape is found.
    """
    hanging = replace(
        problem,
        load=NoPlates(),
        wall=Wall(held=(True, True, True)),
        gravity_g=problem.imaged_gravity_g,
        imaged_gravity_g=(0.0, 0.0, 0.0),
        pressures=(),
        forces=(),
        holds=(),
        tolerance_mm=0.05 * problem.tolerance_mm,
    )
    imaged = [level.nodes for level in model]
    guess = list(imaged)
    for _ in range(MAX_ROUNDS):
        rest = reshaped(model, guess)
        found = equilibrium(rest, hanging)
        if found.solution.outcome.reason:
            raise NoRestShapeError(
                "No stress-free shape was found for imaged_gravity_g = "
                f"{problem.imaged_gravity_g}: {found.solution.outcome.reason}."
            )
        missing = [x - s.x for x, s in zip(imaged, found.states, strict=True)]
        if float(np.abs(missing[-1]).max()) < 0.1 * problem.tolerance_mm:
            return rest
        guess = [x + m for x, m in zip(guess, missing, strict=True)]
    raise NoRestShapeError(
        "No stress-free shape was found for imaged_gravity_g = "
        f"{problem.imaged_gravity_g} in {MAX_ROUNDS} rounds: the body is too soft to "
        "carry its weight there."
    )
