r"""Errors of a simulated specimen: its mesh, the solver's supports, and a measured boundary.

A mesh is too stiff. Linear tetrahedra cannot bend: a beam with eight of them across deflects 3 %
too little. Displacements under given loads converge with the square of the element size,

.. math:: u_h = u + c h^2 \quad\Rightarrow\quad u = u_h + \frac{u_h - u_H}{(H/h)^2 - 1}

(L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307), so a coarser mesh shows the
error of the working mesh. Where displacements are inversely proportional to the stiffness,
softening the material by the same factor corrects it.

Weak springs, numerical supports of the solver, keep a body from drifting and carry part of the
loads. For a soft body or small forces they matter, and the reading of a load cell then depends on
which end is fixed.

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
from palpate.storage.values import FloatArray, Triple
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.diagnosis.problem.inverse_problem import Forward, InverseProblem
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.discretisation import LevelModel, Model, prepare
from palpate.workers.mechanics.fem.equilibrium_sensitivity import RELATIVE_ERROR
from palpate.workers.mechanics.fem.external_forces import spring_stiffness, stated_springs
from palpate.workers.mechanics.fem.loads_and_regions import DisplacementField, Hold
from palpate.workers.organs.specimen.block_lattice import Cells, cells_of, lattices
from palpate.workers.organs.specimen.specimen_keys import StateSpec

# Ratio of cells along a side, coarser to working lattice.
COARSER_CELLS = 0.75
FEWEST_COARSE_CELLS = 3


def part_of_compliance(
    size_mm: Triple, nodes: int, points_mm: FloatArray, problem: Problem
) -> float:
    """Return the ratio of displacements on the working mesh to the extrapolated ones.

    Parameters
    ----------
    size_mm : tuple of float
        Size of the block.
    nodes : int
        Number of nodes of the working mesh.
    points_mm : ndarray, shape (k, 3)
    problem : Problem
        Load case in which the points move.

    Returns
    -------
    float
        At most 1; 1 if no coarser mesh is possible, or nothing moves.

    Raises
    ------
    InputError
        If the body cannot be simulated under these loads.
    """
    fine = cells_of(size_mm, nodes)
    shortest = min(fine)
    ratio = max(FEWEST_COARSE_CELLS, round(COARSER_CELLS * shortest)) / shortest
    if ratio == 1:
        return 1.0
    x, y, z = (max(1, round(ratio * n)) for n in fine)
    coarse: Cells = (x, y, z)
    u, rough = (_moved(size_mm, cells, points_mm, problem) for cells in (fine, coarse))
    spacing = np.cbrt(np.prod(fine) / np.prod(coarse))
    limit = u + (u - rough) / (spacing**2 - 1)
    square = float(np.vdot(limit, limit))
    return min(1.0, float(np.vdot(u, limit)) / square) if square > 0 else 1.0


def _moved(size_mm: Triple, cells: Cells, points_mm: FloatArray, problem: Problem) -> FloatArray:
    hierarchy = lattices(size_mm, cells, next(iter(problem.constants)))
    model: Model = prepare(hierarchy)
    solution = solve(model, problem)
    if not solution.outcome.converged:
        raise InputError(
            "The simulation with E in the middle of its interval failed: "
            f"{solution.outcome.reason}. Check loads, units and E_kpa."
        )
    return np.asarray(
        interpolation_at_points(hierarchy.finest.mesh, points_mm) @ solution.displacement_mm
    )


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
    warnings, model = [], inverse.model.finest
    for problem, state, moved in zip(problems, states, moved_mm, strict=True):
        loads = [float(np.linalg.norm(force.force_n)) for force in problem.forces]
        loads += [abs(reaction.force_n) for reaction in state.reactions]
        held = support_force_n(model, problem, np.asarray(moved)[: len(model.nodes)])
        if loads and held > MOST_OF_FORCES * max(loads) > 0:
            warnings.append(
                f"Numerical supports carry {held:.2g} N in the state {state.name}, "
                f"{100 * held / max(loads):.2g} % of the largest force on the body: loads are out "
                "of balance by that much, and the stiffness may be wrong by as much."
            )
    return tuple(warnings)


# If a singular value is below this fraction of the largest, the points are in a plane.
FLAT_POINTS = 1e-9


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
        equilibrium = forward.equilibrium(model, problem)
        if not equilibrium.solution.outcome.converged:
            raise InputError(
                "A simulation with constants in the middle of their intervals failed: "
                f"{equilibrium.solution.outcome.reason}. Check loads, units, E_kpa and nu."
            )
        changes = [
            change
            for number, hold in enumerate(problem.holds)
            if isinstance(hold.displacement_mm, DisplacementField)
            for change in affine_changes(problem, number, hold.displacement_mm, sd_mm)
        ]
        moved = forward.tangents(equilibrium, changes, RELATIVE_ERROR)
        nothing = compared(np.zeros_like(equilibrium.solution.displacement_mm))
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
    changes = []
    # Points in a plane do not determine the change across it: three modes, not four.
    for mode in sd_mm * U[:, sizes > FLAT_POINTS * sizes[0]].T:
        for axis in range(3):
            step = np.outer(mode, np.eye(3)[axis])
            ahead, behind = (
                _with_hold(problem, number, field, moved + sign * step) for sign in (1, -1)
            )
            changes.append(Change(ahead, behind, 2.0))
    return changes


def _with_hold(
    problem: Problem, number: int, field: DisplacementField, moved: FloatArray
) -> Problem:
    other = replace(field, displacement_mm=tuple(map(tuple, moved.tolist())))
    holds: list[Hold] = list(problem.holds)
    holds[number] = replace(holds[number], displacement_mm=other)
    return replace(problem, holds=tuple(holds))
