r"""Noise that a measured boundary adds to the points that are compared.

A region whose motion is prescribed by b points of a field follows their noise. The affine part
of this noise moves the whole body: with standard deviation sigma of a point and rows
``(1, p - middle)`` in A, its coefficients have the covariance

.. math:: \sigma^2 (A'A)^{-1}

along each axis. With A = U S V', the region moves by sigma times each column of U, and the model
predicts the motion of every other point. The rest of the noise changes sign from point to point
and decays within their spacing; it is neglected.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.problem.forward import Forward
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.equilibrium.sensitivity import RELATIVE_ERROR
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.problem.loads import DisplacementField, Hold

# If a singular value is below this fraction of the largest, the points are in a plane.
FLAT = 1e-9


def boundary_covariance(
    forward: Forward,
    model: Model,
    compared: Callable[[FloatArray], FloatArray],
    problems: Sequence[Problem],
    sd_mm: float,
) -> FloatArray:
    """Return the covariance that measured boundaries add, shape (s m, s m).

    Parameters
    ----------
    forward : Forward
    model : Model
    compared : callable
        Maps displacements of the nodes to the compared components of one state, shape (m,).
    problems : sequence of Problem
        Problems of the s states, with constants in the middle of their intervals.
    sd_mm : float
        Standard deviation of a component of a point of the field, independent between states.

    Raises
    ------
    InputError
        If a state cannot be simulated with these constants.
    """
    blocks = []
    for problem in problems:
        at = forward.equilibrium(model, problem)
        if not at.solution.outcome.converged:
            raise InputError(
                "A simulation with constants in the middle of their intervals failed: "
                f"{at.solution.outcome.reason}. Check loads, units, E_kpa and nu."
            )
        changes = [
            change
            for number, hold in enumerate(problem.holds)
            if isinstance(hold.displacement_mm, DisplacementField)
            for change in affine_changes(problem, number, hold.displacement_mm, sd_mm)
        ]
        moved = forward.tangents(at, changes, RELATIVE_ERROR)
        nothing = compared(np.zeros_like(at.solution.displacement_mm))
        columns = np.array([compared(u) for u in moved]).reshape(-1, len(nothing))
        blocks.append(columns.T @ columns)
    return np.asarray(block_diag(*blocks))


def affine_changes(
    problem: Problem, number: int, field: DisplacementField, sd_mm: float
) -> list[Change]:
    """Return changes of one hold by one standard deviation of each affine mode."""
    points, moved = np.array(field.points_mm), np.array(field.displacement_mm)
    A = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    U, sizes, _ = np.linalg.svd(A, full_matrices=False)
    found = []
    # Points in a plane do not determine the change across it: three modes, not four.
    for mode in sd_mm * U[:, sizes > FLAT * sizes[0]].T:
        for axis in range(3):
            step = np.outer(mode, np.eye(3)[axis])
            ahead, behind = (
                _with_hold(problem, number, field, moved + sign * step) for sign in (1, -1)
            )
            found.append(Change(ahead, behind, 2.0))
    return found


def _with_hold(
    problem: Problem, number: int, field: DisplacementField, moved: FloatArray
) -> Problem:
    other = replace(field, displacement_mm=tuple(map(tuple, moved.tolist())))
    holds: list[Hold] = list(problem.holds)
    holds[number] = replace(holds[number], displacement_mm=other)
    return replace(problem, holds=tuple(holds))
