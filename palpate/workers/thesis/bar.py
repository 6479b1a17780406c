"""The cantilever bar of thesis section 3.3.2: a gold standard and eight wrong deformations.

The thesis gives no size, material or force of its bar, and the figure with the directions of F0 to
F4 is lost. The values assumed here: a soft square bar, bent by the gold-standard force by about its
own thickness; F0 and F1 along -x, F2 opposite to them, F3 and F4 along -y and y. With these values,
deformations 1 to 8, which the thesis numbers from best to worst, are increasingly far from the gold
standard.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, TetMesh, Tissue, Triple, Volume
from palpate.workers.comparison.coefficients.coefficients import Coefficients, coefficients
from palpate.workers.comparison.similarity.score import Surface
from palpate.workers.comparison.warp.warp_volume import warp_labels
from palpate.workers.mechanics.fem.elements.model import Model, prepare
from palpate.workers.mechanics.fem.equilibrium.solve import solve
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.loads import DeadForce, NoPlates, Wall
from palpate.workers.mechanics.fem.problem.outcome import Outcome
from palpate.workers.mechanics.fem.problem.regions import Box
from palpate.workers.organs.specimen.block import block
from palpate.workers.thesis.scale import Scale, check_scale

LENGTH_MM, SIDE_MM = 100.0, 20.0
# A gel of 30 kPa, nearly incompressible as all tissues of the thesis.
GEL = Constants(young_mpa=0.03, poisson=0.49)
# Bends the tip by about one side: F L^3 / 3 E I = 22 mm according to beam theory.
GOLD_FORCE_N = 0.026
WRONG = 1.2  # F1 to F4 as multiples of F0

# Directions of the forces, in multiples of F0; the thesis' table of configurations.
_F0, _F1, _F2 = (-1.0, 0.0), (-WRONG, 0.0), (WRONG, 0.0)
_F3, _F4 = (0.0, -WRONG), (0.0, WRONG)
DEFORMATIONS: dict[int, tuple[str, tuple[tuple[float, float], ...]]] = {
    1: ("110 % F0", ((-1.1, 0.0),)),
    2: ("F1", (_F1,)),
    3: ("F1 and F4", (_F1, _F4)),
    4: ("F1 and F3", (_F1, _F3)),
    5: ("F2", (_F2,)),
    6: ("F3", (_F3,)),
    7: ("F4", (_F4,)),
    8: ("F3 and F2", (_F3, _F2)),
}
# From best to worst; the thesis does not rank within a group.
GROUPS: tuple[tuple[int, ...], ...] = ((1, 2), (3, 4), (5, 6, 7), (8,))

NODES: dict[Scale, int] = {"sketch": 600, "reduced": 3_000, "full": 30_000}
VOXEL_MM: dict[Scale, float] = {"sketch": 2.0, "reduced": 1.0, "full": 0.5}


# Displacements of the nodes in mm, and the outcome of the simulation.
Bent = tuple[FloatArray, Outcome]


@dataclass(frozen=True, eq=False)
class Bar:
    """A meshed bar and its undeformed voxels; its axis is z, and z = 0 is clamped.

    Parameters
    ----------
    mesh : TetMesh
    model : Model
        The mesh, prepared for the solver.
    voxels : Volume
        Labelled glandular inside the bar, because scores compare that label.
    """

    mesh: TetMesh
    model: Model
    voxels: Volume


@dataclass(frozen=True)
class BarRow:
    """Comparison of a wrong deformation with the gold standard.

    Parameters
    ----------
    number : int
        Number of the deformation, 1 to 8, from best to worst.
    forces : str
        Applied forces, in the notation of the thesis.
    force_n : tuple of float
        Sum of the forces on the free end.
    tip_mm : tuple of float
        Mean displacement of the free end.
    outcome : Outcome
        Outcome of the simulation.
    coefficients : Coefficients or None
        None if the simulation did not converge.
    """

    number: int
    forces: str
    force_n: Triple
    tip_mm: Triple
    outcome: Outcome
    coefficients: Coefficients | None


@dataclass(frozen=True)
class BarExperiment:
    """All rows of the bar, in the order of `DEFORMATIONS`.

    Parameters
    ----------
    scale : {"sketch", "reduced", "full"}
    nodes : int
        Number of nodes of the finest mesh.
    voxel_mm : float
    gold_tip_mm : tuple of float
        Mean displacement of the free end under F0.
    rows : tuple of BarRow
    """

    scale: Scale
    nodes: int
    voxel_mm: float
    gold_tip_mm: Triple
    rows: tuple[BarRow, ...]


def make_bar(scale: Scale) -> Bar:
    """Mesh the bar.

    Raises
    ------
    InputError
        If the scale is unknown.
    """
    check_scale(scale)
    size = (SIDE_MM, SIDE_MM, LENGTH_MM)
    hierarchy = block(size, NODES[scale], Tissue.GLANDULAR)
    h = VOXEL_MM[scale]
    nx, ny, nz = (round(s / h) for s in size)
    solid = np.full((nz, ny, nx), Tissue.GLANDULAR, np.uint8)
    voxels = Volume(solid, (h, h, h), (h / 2, h / 2, h / 2))
    return Bar(hierarchy.finest.mesh, prepare(hierarchy), voxels)


def bend(bar: Bar, force_n: Triple, material: Constants = GEL) -> Bent:
    """Load the free end of the bar with a force of constant direction.

    Parameters
    ----------
    bar : Bar
    force_n : tuple of float
        Force along x, y and z.
    material : Constants

    Returns
    -------
    displacement_mm : ndarray, shape (n, 3)
    outcome : Outcome
    """
    end = Box((-np.inf, -np.inf, LENGTH_MM - 1e-3), (np.inf, np.inf, np.inf))
    problem = Problem(
        constants={Tissue.GLANDULAR: material},
        load=NoPlates(),
        wall=Wall((True, True, True)),
        forces=(DeadForce(force_n, end),),
    )
    solution = solve(bar.model, problem)
    return solution.displacement_mm, solution.outcome


def force_of(number: int) -> Triple:
    """Return the sum of the forces of deformation `number` in N; 0 is the gold standard."""
    parts = (_F0,) if number == 0 else DEFORMATIONS[number][1]
    total = np.sum(parts, axis=0) * GOLD_FORCE_N
    return float(total[0]), float(total[1]), 0.0


def compared_bars(
    scale: Scale, bar: Bar, bent: Mapping[int, Bent], surface: Surface = "boundary"
) -> BarExperiment:
    """Compare bent bars; number 0 is the gold standard, 1 to 8 are the others.

    Raises
    ------
    InputError
        If the gold standard did not converge.
    """
    displacement, outcome = bent[0]
    if not outcome.converged:
        raise InputError(f"The gold standard of the bar does not converge: {outcome.reason}.")
    gold = warp_labels(bar.voxels, bar.mesh, displacement)
    rows = tuple(bar_row(bar, gold, number, bent[number], surface) for number in DEFORMATIONS)
    tip = _tip(bar, displacement)
    return BarExperiment(scale, len(bar.mesh.nodes), VOXEL_MM[scale], tip, rows)


def bar_row(
    bar: Bar, gold: Volume, number: int, bent: Bent, surface: Surface = "boundary"
) -> BarRow:
    """Compare wrong deformation `number` with the voxels of the gold standard."""
    force = force_of(number)
    displacement, outcome = bent
    compared = None
    if outcome.converged:
        wrong = warp_labels(bar.voxels, bar.mesh, displacement, gold)
        compared = coefficients(wrong, gold, (Tissue.GLANDULAR,), surface)
    forces = DEFORMATIONS[number][0]
    return BarRow(number, forces, force, _tip(bar, displacement), outcome, compared)


def _tip(bar: Bar, displacement: FloatArray) -> Triple:
    end = bar.mesh.nodes[:, 2] > LENGTH_MM - 1e-6
    x, y, z = displacement[end].mean(axis=0)
    return float(x), float(y), float(z)
