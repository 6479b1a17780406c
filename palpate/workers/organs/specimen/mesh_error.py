r"""Excess stiffness of a mesh, estimated from two meshes.

Linear tetrahedra cannot bend: a beam with eight of them across deflects 3 % too little.
Displacements under given loads converge with the square of the element size,

.. math:: u_h = u + c h^2 \quad\Rightarrow\quad u = u_h + \frac{u_h - u_H}{(H/h)^2 - 1}

(L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307), so a coarser mesh shows the
error of the working mesh. Where displacements are inversely proportional to the stiffness,
softening the material by the same factor corrects it.
"""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Triple
from palpate.workers.comparison.observation.point_interpolation import interpolation
from palpate.workers.mechanics.fem.elements.model import Model, prepare
from palpate.workers.mechanics.fem.equilibrium.solve import solve
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.organs.specimen.block import Cells, cells_of, lattices

# Ratio of cells along a side, coarser to working lattice.
COARSER = 0.75
FEWEST = 3


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
    ratio = max(FEWEST, round(COARSER * shortest)) / shortest
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
    return np.asarray(interpolation(hierarchy.finest.mesh, points_mm) @ solution.displacement_mm)
