r"""Signed distances between the surfaces of a cornea and its image, and their derivatives.

The nodes on both surfaces, displaced by the model, are compared with the same surface of the
target. A node represents a length :math:`\ell` of contour; for errors of the image with standard
deviation :math:`\sigma`, correlated over a length c, its distance d has the weight
:math:`\ell / (c\,\sigma^2)`. So J'J is the information in `cornea.comparison.identifiability`,
independent of the mesh.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.storage.records.tasks import FreeParameter
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.organs.cornea.comparison.identifiability import ContourNoise, pixel_rounding
from palpate.workers.organs.cornea.comparison.surface_residual import (
    ANTERIOR,
    POSTERIOR,
    SurfaceResidual,
)
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.polyline import arclength_mm
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.outcome import CorneaOutcome
from palpate.workers.organs.cornea.solver.sensitivity import STEP, Change, sensitivity
from palpate.workers.organs.cornea.solver.solve import equilibrium
from palpate.workers.organs.normal_equations import normal_equations
from palpate.workers.organs.organ import Residuals, logarithmic

# Accuracy of the score of a study for a simulated section.
SIMULATED = pixel_rounding(2.0)
# Error of a surface segmented in a frame; see `workers.organs.cornea.frames.registration`.
SEGMENTED = ContourNoise("10 µm, correlated over 0.5 mm", 10.0, 0.5)
# Closer to an end of an imaged surface, a displaced node may have no point next to it.
END_MARGIN_MM = 0.3
# Non-negative parameters at zero are differentiated over this fraction of their interval.
ONE_SIDED = 1e-4

CandidateOf = Callable[[Mapping[str, float]], Candidate]


@dataclass(frozen=True, eq=False)
class SurfaceObservation:
    """Inputs of the residuals from mesh and target.

    Parameters
    ----------
    nodes : ndarray, shape (k,)
        Nodes of both surfaces.
    points : InterfacePoints
        The same nodes in the image of the undeformed cornea.
    compare : SurfaceResidual
    weight : ndarray, shape (k,)
        Factor of a distance in mm; see the module docstring.
    noise : str
        The noise as text.
    """

    nodes: IntArray
    points: InterfacePoints
    compare: SurfaceResidual
    weight: FloatArray
    noise: str


@dataclass(frozen=True, eq=False)
class FittedCornea:
    """See `workers.organs.organ.Fitted`."""

    solution: CorneaOutcome
    residuals: Residuals | None


def observe_surfaces(mesh: T6Mesh, target: Section, imaged: bool) -> SurfaceObservation:
    """Select the nodes that the target shows, and compute their weights.

    Parameters
    ----------
    mesh : T6Mesh
        Mesh of the undeformed section.
    target : Section
    imaged : bool
        Whether the target is an image; else it was simulated.
    """
    noise = SEGMENTED if imaged else SIMULATED
    surfaces = (
        (ANTERIOR, mesh.anterior, target.anterior_mm),
        (POSTERIOR, mesh.posterior, target.posterior_mm),
    )
    nodes, lengths, interfaces = [], [], []
    for number, surface, line in surfaces:
        x = mesh.nodes_mm[surface, 0]
        low, high = line[0, 0] + END_MARGIN_MM, line[-1, 0] - END_MARGIN_MM
        shown = (x > low) & (x < high)
        nodes.append(surface[shown])
        lengths.append(np.gradient(arclength_mm(mesh.nodes_mm[surface]))[shown])
        interfaces.append(np.full(int(shown.sum()), number, np.int32))
    chosen, length = np.concatenate(nodes), np.concatenate(lengths)
    own = np.concatenate(interfaces)
    places = np.pad(mesh.nodes_mm[chosen], ((0, 0), (0, 1)))
    return SurfaceObservation(
        nodes=chosen,
        points=InterfacePoints(places, np.zeros_like(places), own, length, own),
        compare=SurfaceResidual(target),
        weight=1e3 / noise.sd_um * np.sqrt(length / noise.correlation_mm),
        noise=noise.name,
    )


def fit_surfaces(
    candidate_at: CandidateOf,
    constants: Mapping[str, float],
    free: Sequence[FreeParameter],
    observation: SurfaceObservation,
) -> FittedCornea:
    """Deform a cornea and differentiate its residuals; see `Organ.fit`.

    Parameters
    ----------
    candidate_at : callable
        Maps all parameters, in internal names and units, to a candidate.
    constants : mapping of str to float
        All parameters.
    free : sequence of FreeParameter
    observation : SurfaceObservation

    Raises
    ------
    InputError
        If constants or load are inconsistent.
    """
    candidate = candidate_at(constants)
    at = equilibrium(candidate.prepared, candidate.constants, candidate.load)
    outcome = CorneaOutcome(at.solution)
    if not outcome.converged:
        return FittedCornea(outcome, None)
    sides = [_either_side(constants[p["name"]], p) for p in free]
    smooth = [i for i, (_, behind, _) in enumerate(sides) if behind is not None]
    changes = [_change(candidate_at, constants, free[i]["name"], sides[i]) for i in smooth]
    derivatives = np.empty((len(free), *outcome.displacement_mm.shape))
    derivatives[smooth] = sensitivity(candidate, changes, at).derivatives
    for i in set(range(len(free))) - set(smooth):
        ahead, _, step = sides[i]
        derivatives[i] = _by_solving(
            candidate_at({**constants, free[i]["name"]: ahead}), outcome.displacement_mm, step
        )
    moved = observation.points.points[:, :2] + outcome.displacement_mm[observation.nodes]
    distances, normals = observation.compare(moved, observation.points)
    shifts = np.einsum("kni,ni->nk", derivatives[:, observation.nodes], normals[:, :2])
    weight = observation.weight
    none_in_common = np.zeros((len(distances), 0))
    equations = normal_equations(
        weight * distances, weight[:, None] * shifts, none_in_common, robust=False
    )
    return FittedCornea(outcome, Residuals(distances, equations, observation.noise))


def _either_side(value: float, p: FreeParameter) -> tuple[float, float | None, float]:
    """Return values on either side of a parameter, and their difference in its unit.

    The difference is in logarithms for a parameter fitted as one; one-sided at zero.
    """
    if logarithmic(p):
        return value * float(np.exp(STEP)), value * float(np.exp(-STEP)), 2 * STEP
    span = p["upper"] - p["lower"]
    if p["lower"] == 0 and value < STEP * span:
        return value + ONE_SIDED * span, None, ONE_SIDED * span
    return value + STEP * span, value - STEP * span, 2 * STEP * span


def _change(
    candidate_at: CandidateOf,
    constants: Mapping[str, float],
    name: str,
    side: tuple[float, float | None, float],
) -> Change:
    ahead, behind, apart = side
    if behind is None:
        raise AssertionError(f"{name} has only one side")
    plus, minus = (candidate_at({**constants, name: value}) for value in (ahead, behind))
    return Change(plus, minus, apart / 2)


def _by_solving(ahead: Candidate, displacement_mm: FloatArray, step: float) -> FloatArray:
    """Return a forward difference with respect to a parameter at zero; zero if it fails."""
    solution = equilibrium(ahead.prepared, ahead.constants, ahead.load).solution
    if not solution.converged:
        return np.zeros_like(displacement_mm)
    return (solution.displacement_mm - displacement_mm) / step
