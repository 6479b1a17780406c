"""Balance of forces: the part of the loads that numerical supports of the solver carry.

Weak springs keep a body from drifting. For a soft body or small forces they matter, and
the reading of a load cell then depends on which end is fixed.
"""

from collections.abc import Sequence

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.mechanics.fem.elements.external_forces import spring_stiffness, stated_springs
from palpate.workers.mechanics.fem.elements.model import LevelModel
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.organs.specimen.keys.loads import StateSpec

# Supports that carry less than this fraction of the known forces are negligible.
MOST_OF_FORCES = 0.01


def support_force_n(model: LevelModel, problem: Problem, moved_mm: FloatArray) -> float:
    """Return the force of the numerical supports on a body.

    Parameters
    ----------
    model : LevelModel
        The finest level, with n nodes.
    problem : Problem
    moved_mm : ndarray, shape (n, 3)
        Displacements of its nodes.
    """
    springs = spring_stiffness(model, problem) - stated_springs(model, problem)
    return float(np.linalg.norm((springs * moved_mm).sum(axis=0)))


def supported(
    inverse: InverseProblem,
    problems: Sequence[Problem],
    states: Sequence[StateSpec],
    moved_mm: Sequence[FloatArray],
) -> tuple[str, ...]:
    """Return a warning for each state whose numerical supports carry a noticeable force.

    Parameters
    ----------
    inverse : InverseProblem
    problems, states
        One for each scan.
    moved_mm : sequence of ndarray
        Displacements of the nodes, followed by those of load cells.
    """
    found, model = [], inverse.model.finest
    for problem, state, moved in zip(problems, states, moved_mm, strict=True):
        loads = [float(np.linalg.norm(force.force_n)) for force in problem.forces]
        loads += [abs(reaction.force_n) for reaction in state.reactions]
        held = support_force_n(model, problem, np.asarray(moved)[: len(model.nodes)])
        if loads and held > MOST_OF_FORCES * max(loads) > 0:
            found.append(
                f"Numerical supports carry {held:.2g} N in the state {state.name}, "
                f"{100 * held / max(loads):.2g} % of the largest force on the body: loads are out "
                "of balance by that much, and the stiffness may be wrong by as much."
            )
    return tuple(found)
