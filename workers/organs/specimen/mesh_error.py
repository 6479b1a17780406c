r"""How much stiffer a mesh is than the body, from two meshes.

Linear tetrahedra do not bend: a beam of eight of them across gives way by 3 % less than it
should. Displacements under given loads approach their limit with the square of the element,

.. math:: u_h = u + c h^2 \quad\Rightarrow\quad u = u_h + \frac{u_h - u_H}{(H/h)^2 - 1}

(L. F. Richardson, Phil. Trans. R. Soc. A 210 (1911) 307), so a coarser mesh tells what the
working mesh lacks. Where displacements are inverse to the stiffness, a material that is
softer by the same part makes good for it.
"""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Triple
from palpate.workers.comparison.observation.point_interpolation import interpolation
from palpate.workers.mechanics.fem.elements.model import Model, prepare
from palpate.workers.mechanics.fem.equilibrium.solve import solve
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.organs.specimen.block import Cells, cells_of, lattices

# Cells of the coarser lattice over those of the working one.
COARSER = 0.75
FEWEST = 3


def part_of_compliance(
    size_mm: Triple, nodes: int, points_mm: FloatArray, problem: Problem
) -> float:
    """Return displacement of some points on the working mesh over that of the body.

    Parameters
    ----------
    size_mm : tuple of float
        Of the block.
    nodes : int
        Of the working mesh.
    points_mm : ndarray, shape (k, 3)
    problem : Problem
        A loading of the body in which the points move.

    Returns
    -------
    float
        At most 1; 1 where the mesh is as coarse as can be, or nothing moves.

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
            "The body was not solved under its loads at the middle of the plausible stiffness: "
            f"{solution.outcome.reason}. Check loads, units and E_kpa."
        )
    return np.asarray(interpolation(hierarchy.finest.mesh, points_mm) @ solution.displacement_mm)
