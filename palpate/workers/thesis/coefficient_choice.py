"""The choice of similarity coefficients by a bent bar and a turned cylinder (thesis section 3.3).

The cantilever bar of section 3.3.2 has a gold standard and eight wrong deformations. The thesis
gives no size, material or force of its bar, and the figure with the directions of F0 to F4 is lost.
The values assumed here: a soft square bar, bent by the gold-standard force by about its own
thickness; F0 and F1 along -x, F2 opposite to them, F3 and F4 along -y and y. With these values,
deformations 1 to 8, which the thesis numbers from best to worst, are increasingly far from the gold
standard.

The cylinder of sections 3.3.2 and 3.3.3 (Figs. 3.6 to 3.8) is rotated about an axis assumed
perpendicular to its own: a rotation about its own axis would change nothing. The thesis gives no
size; here the length is four diameters.

The selection follows the argument of section 3.3.2.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, TetMesh, Tissue, Triple, Volume
from palpate.workers.comparison.similarity_coefficients import (
    COEFFICIENT_NAMES,
    HAUSDORFF_NAMES,
    Coefficients,
    coefficients,
)
from palpate.workers.comparison.similarity_score import Surface
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Outcome, Problem
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box, DeadForce, NoPlates, Wall
from palpate.workers.organs.specimen.block_lattice import block
from palpate.workers.thesis.phantom_compression import Scale, check_scale

BAR_LENGTH_MM, BAR_SIDE_MM = 100.0, 20.0
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

BAR_NODES: dict[Scale, int] = {"sketch": 600, "reduced": 3_000, "full": 30_000}
BAR_VOXEL_MM: dict[Scale, float] = {"sketch": 2.0, "reduced": 1.0, "full": 0.5}


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
    size = (BAR_SIDE_MM, BAR_SIDE_MM, BAR_LENGTH_MM)
    hierarchy = block(size, BAR_NODES[scale], Tissue.GLANDULAR)
    h = BAR_VOXEL_MM[scale]
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
    end = Box((-np.inf, -np.inf, BAR_LENGTH_MM - 1e-3), (np.inf, np.inf, np.inf))
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
    return BarExperiment(scale, len(bar.mesh.nodes), BAR_VOXEL_MM[scale], tip, rows)


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
    end = bar.mesh.nodes[:, 2] > BAR_LENGTH_MM - 1e-6
    x, y, z = displacement[end].mean(axis=0)
    return float(x), float(y), float(z)


CYLINDER_LENGTH_MM, CYLINDER_RADIUS_MM = 80.0, 10.0
CYLINDER_VOXEL_MM: dict[Scale, float] = {"sketch": 1.0, "reduced": 1.0, "full": 0.5}
ANGLES_DEG = (0, 1, 2, *range(5, 180, 5), 178, 179, 180)


@dataclass(frozen=True)
class CylinderRow:
    """A cylinder rotated by an angle, compared with itself.

    Parameters
    ----------
    angle_deg : float
    jc, dc : float
        Jaccard and Dice coefficients.
    mhd_mm : float
        The variant D22.
    gsf : float
        -inf where the voxels are identical.
    """

    angle_deg: float
    jc: float
    dc: float
    mhd_mm: float
    gsf: float


def cylinder(angle_deg: float, voxel_mm: float) -> Volume:
    """Return the voxels of a cylinder whose axis is rotated from x by an angle in the x-y plane.

    A voxel belongs to the cylinder if its centre does. Voxel centres are half a voxel off the
    planes of symmetry, so that a rotation by 180 degrees gives the same voxels.

    Raises
    ------
    InputError
        If the voxel size is not positive.
    """
    if not voxel_mm > 0:
        raise InputError(f"The voxel size must be > 0 mm, got {voxel_mm:g} mm.")
    reach = math.hypot(CYLINDER_LENGTH_MM / 2, CYLINDER_RADIUS_MM) + voxel_mm
    n, n_z = (2 * math.ceil(r / voxel_mm) for r in (reach, CYLINDER_RADIUS_MM + voxel_mm))
    centres = (np.arange(n) - (n - 1) / 2) * voxel_mm
    z = ((np.arange(n_z) - (n_z - 1) / 2) * voxel_mm)[:, None, None]
    turn = math.radians(angle_deg)
    # Rounded so that rotations by 90 or 180 degrees are exact.
    c, s = round(math.cos(turn), 15), round(math.sin(turn), 15)
    along = np.abs(c * centres[None, :] + s * centres[:, None])
    across = (c * centres[:, None] - s * centres[None, :]) ** 2
    inside = (along <= CYLINDER_LENGTH_MM / 2) & (across + z**2 <= CYLINDER_RADIUS_MM**2)
    values = np.where(inside, Tissue.GLANDULAR, Tissue.AIR).astype(np.uint8)
    start = (float(centres[0]), float(centres[0]), float(z[0, 0, 0]))
    return Volume(values, (voxel_mm,) * 3, start)


def cylinder_row(angle_deg: float, voxel_mm: float, surface: Surface = "boundary") -> CylinderRow:
    """Compare the rotated cylinder with the cylinder along x."""
    turned, still = cylinder(angle_deg, voxel_mm), cylinder(0.0, voxel_mm)
    found = coefficients(turned, still, (Tissue.GLANDULAR,), surface)
    return CylinderRow(angle_deg, found.jc, found.dc, found.mhd_mm, found.gsf)


def cylinder_experiment(
    scale: Scale = "reduced", surface: Surface = "boundary"
) -> tuple[CylinderRow, ...]:
    """Rotate the cylinder from 0 to 180 degrees.

    Parameters
    ----------
    scale : {"sketch", "reduced", "full"}
        Voxels of 1 mm, or 0.5 mm at full scale.
    surface : {"boundary", "all"}
        See `workers.comparison.similarity_score.coefficients`.

    Raises
    ------
    InputError
        If the scale is unknown.
    """
    check_scale(scale)
    return tuple(cylinder_row(angle, CYLINDER_VOXEL_MM[scale], surface) for angle in ANGLES_DEG)


WORST = GROUPS[2]  # the deformations that "must be considered the least similar"
RIGHT_HALF = (*GROUPS[0], *GROUPS[1])
OVERLAPS, SIGNED = ("JC", "DC"), ("dV", "SM")


@dataclass(frozen=True)
class Selection:
    """Behaviour of each coefficient over the eight deformations.

    Parameters
    ----------
    curves : dict of str to tuple of float
        The 28 coefficients over the deformations that converged, each divided by its
        largest magnitude (thesis Fig. 3.5).
    numbers : tuple of int
        The deformations that converged.
    kept, rejected : tuple of str
        Hausdorff variants under which each of deformations 5 to 7 is worse than each of 1
        to 4, and the remaining variants.
    monotone : dict of str to bool
        True if a coefficient, including GSF, worsens from each of `GROUPS` to the next. Volume
        difference and signed mean worsen as their magnitude grows, JC and DC as they fall.
    """

    curves: dict[str, tuple[float, ...]]
    numbers: tuple[int, ...]
    kept: tuple[str, ...]
    rejected: tuple[str, ...]
    monotone: dict[str, bool]


def select(experiment: BarExperiment) -> Selection:
    """Apply the thesis' argument to the rows that converged."""
    rows = [(row.number, row.coefficients) for row in experiment.rows if row.coefficients]
    values = {name: {n: c.by_name[name] for n, c in rows} for name in COEFFICIENT_NAMES}
    values["GSF"] = {n: c.gsf for n, c in rows}
    misfit = {name: _misfit(name, each) for name, each in values.items()}
    kept = tuple(n for n in HAUSDORFF_NAMES if _worse(misfit[n], RIGHT_HALF, WORST))
    return Selection(
        curves={name: _normalised(list(values[name].values())) for name in COEFFICIENT_NAMES},
        numbers=tuple(n for n, _ in rows),
        kept=kept,
        rejected=tuple(n for n in HAUSDORFF_NAMES if n not in kept),
        monotone={name: monotone_in_groups(each) for name, each in misfit.items()},
    )


def _misfit(name: str, values: dict[int, float]) -> dict[int, float]:
    """Return the values with signs chosen so that larger is worse."""
    if name in OVERLAPS:
        return {n: -v for n, v in values.items()}
    if name in SIGNED:
        return {n: abs(v) for n, v in values.items()}
    return values


def monotone_in_groups(misfit: dict[int, float]) -> bool:
    """Return True if all misfits of each group exceed all misfits of the previous group."""
    return all(_worse(misfit, better, worse) for better, worse in pairwise(GROUPS))


def _worse(misfit: dict[int, float], better: tuple[int, ...], worse: tuple[int, ...]) -> bool:
    low = [misfit[n] for n in better if n in misfit]
    high = [misfit[n] for n in worse if n in misfit]
    return not low or not high or max(low) < min(high)


def _normalised(values: list[float]) -> tuple[float, ...]:
    largest = max((abs(v) for v in values), default=0.0)
    return tuple(v / largest if largest else 0.0 for v in values)
