"""The stress-free shape of a body whose image already carries gravity.

The inverse fixed point (Rajagopal et al. 2007; Sellier 2011): load the present
guess, and move it by what is missing to the image.
"""

from dataclasses import replace

import numpy as np

from workers.mechanics.fem.level import Level
from workers.mechanics.fem.load_stepping import LoadStepping
from workers.mechanics.fem.loads import NoPlates, Wall
from workers.mechanics.fem.model import Model, reshaped
from workers.mechanics.fem.problem import Problem

MAX_ROUNDS = 60


class NoStressFreeShapeError(Exception):
    """No stress-free shape was found: an ordinary ending of a simulation, with a reason."""


def stress_free(model: Model, problem: Problem) -> Model:
    """Return the model whose shape under `problem.imaged_gravity_g` is that of `model`.

    While the image was taken the chest wall held the body in every direction and
    no plate touched it.

    Raises
    ------
    NoStressFreeShapeError
        If no such shape is found.
    InputError
        If a tissue of the mesh has no constants.
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
        levels = tuple(Level.build(level, hanging) for level in rest)
        path = LoadStepping(rest, hanging, levels).run()
        if path.reason:
            raise NoStressFreeShapeError(
                "No stress-free shape was found for imaged_gravity_g = "
                f"{problem.imaged_gravity_g}: {path.reason}."
            )
        missing = [x - s.x for x, s in zip(imaged, path.states, strict=True)]
        if float(np.abs(missing[-1]).max()) < 0.1 * problem.tolerance_mm:
            return rest
        guess = [x + m for x, m in zip(guess, missing, strict=True)]
    raise NoStressFreeShapeError(
        "No stress-free shape was found for imaged_gravity_g = "
        f"{problem.imaged_gravity_g} in {MAX_ROUNDS} rounds: the body is too soft to "
        "carry its weight there."
    )
