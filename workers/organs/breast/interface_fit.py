"""Signed distances between the interfaces of a simulated breast and its image, and tangents.

The residuals are those of a diagnosis: points on the outline and on the gland of the body at
rest, moved by the model, compared with the same interface of the target.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix

from storage.task_records import FreeParameter
from storage.values import FloatArray, Tissue, Volume
from workers.body.images.largest_component import in_air
from workers.body.mesh.hierarchy import Hierarchy
from workers.comparison.observation.interface import (
    GLANDULAR,
    OUTLINE,
    Interface,
    InterfacePoints,
    interface_points,
)
from workers.comparison.observation.noise import SegmentationNoise, correlation, covariance
from workers.comparison.observation.point_interpolation import interpolation
from workers.comparison.observation.residual import observe, residual
from workers.diagnosis.linearisation import Linearised, factored
from workers.diagnosis.settings import SETTINGS
from workers.mechanics.effects.plate_friction import FRICTION
from workers.mechanics.fem.model import Model
from workers.mechanics.fem.outcome import Solution
from workers.mechanics.fem.problem import Problem
from workers.mechanics.fem.sensitivity import Change, tangents
from workers.mechanics.fem.solve import Equilibrium, equilibrium
from workers.organs.breast.study_noise import study_noise
from workers.organs.organ import Residuals, logarithmic

# Between neighbouring points: a breast of 445 ml then has some 2,000.
SPACING_MM = 4.0
# Difference of a parameter for its derivative: of a logarithm, or over the searched interval.
STEP = 1e-4
# The same of friction, which sets in with full force and then tires.
FRICTION_STEP = 0.02


@dataclass(frozen=True, eq=False)
class BreastObservation:
    """What residuals need of body and target.

    Parameters
    ----------
    points : InterfacePoints
        On the interfaces at rest, k of them.
    at_points : csr_matrix, shape (k, n)
        From displacements of the nodes to those of the points.
    compare : callable
        From moved points to signed distances, (k,) in mm, and their derivatives, (k, 3).
    covariance_factor : ndarray, shape (k, k)
        Lower Cholesky factor of the covariance of the noise.
    noise : str
        The same in words.
    """

    points: InterfacePoints
    at_points: csr_matrix
    compare: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    covariance_factor: FloatArray
    noise: str


@dataclass(frozen=True, eq=False)
class FittedBreast:
    """See `workers.organs.organ.Fitted`."""

    solution: Solution
    residuals: Residuals | None


ProblemOf = Callable[[Mapping[str, float]], Problem]


def observe_target(
    body: Volume, mesh: Hierarchy, target: Volume, imaged: bool
) -> BreastObservation:
    """Put points on the interfaces of a body and find the same interfaces in its target.

    Raises
    ------
    InputError
        If body and target share no interface.
    """
    rest, loaded = in_air(body), in_air(target)
    noise = study_noise(body, target, imaged)
    interfaces = _shared(rest, loaded)
    margin = SETTINGS.points.wall_margin_mm
    clear_mm = SETTINGS.points.clear_noises * noise.sd_mm
    points = interface_points(rest, interfaces, SPACING_MM, margin, clear_mm)
    return BreastObservation(
        points=points,
        at_points=interpolation(mesh.finest.mesh, points.points),
        compare=partial(residual, points=points, observed=observe(loaded, interfaces)),
        covariance_factor=factored(_covariance(points, noise)),
        noise=_in_words(noise),
    )


def fit_interfaces(
    model: Model,
    problem_of: ProblemOf,
    constants: Mapping[str, float],
    free: Sequence[FreeParameter],
    observation: BreastObservation,
) -> FittedBreast:
    """Deform a breast and differentiate its residuals; see `Organ.fit`."""
    at = equilibrium(model, problem_of(constants))
    if not at.solution.outcome.converged:
        return FittedBreast(at.solution, None)
    r, normals = _compare(observation, at)
    columns = np.empty((len(r), len(free)))
    smooth = [i for i, p in enumerate(free) if p["name"] not in FRICTION.names]
    changes = [_change(at, problem_of, constants, free[i]) for i in smooth]
    for i, nodal in zip(smooth, tangents(at, changes), strict=True):
        columns[:, i] = ((observation.at_points @ nodal) * normals).sum(axis=1)
    for i in set(range(len(free))) - set(smooth):
        columns[:, i] = _by_solving(model, at, problem_of, constants, free[i], observation, r)
    m = len(r)
    noise = Linearised(r, columns, np.ones(len(free)), np.zeros(len(free)), _factor(observation, m))
    white = Residuals(r, noise.whitened_residual, noise.whiten(columns), observation.noise)
    return FittedBreast(at.solution, white)


def _factor(observation: BreastObservation, m: int) -> FloatArray:
    if observation.covariance_factor.shape != (m, m):
        raise AssertionError("one row of the covariance for each residual")
    return observation.covariance_factor


def _compare(observation: BreastObservation, at: Equilibrium) -> tuple[FloatArray, FloatArray]:
    moved = observation.at_points @ at.solution.displacement_mm
    return observation.compare(observation.points.points + moved)


def _change(
    at: Equilibrium, problem_of: ProblemOf, constants: Mapping[str, float], p: FreeParameter
) -> Change:
    """Return the problems on either side; at the end of what is admissible, on one side."""
    ahead, behind, step = _either_side(constants[p["name"]], p)
    plus = problem_of({**constants, p["name"]: ahead})
    if behind == constants[p["name"]]:
        return Change(plus, at.problem, step)
    return Change(plus, problem_of({**constants, p["name"]: behind}), step)


def _either_side(value: float, p: FreeParameter) -> tuple[float, float, float]:
    if logarithmic(p):
        return value * float(np.exp(STEP)), value * float(np.exp(-STEP)), 2 * STEP
    h = STEP * (p["upper"] - p["lower"])
    # A parameter that begins at zero may not be negative.
    if p["lower"] == 0 and value < h:
        return value + h, value, h
    return value + h, value - h, 2 * h


def _by_solving(
    model: Model,
    at: Equilibrium,
    problem_of: ProblemOf,
    constants: Mapping[str, float],
    p: FreeParameter,
    observation: BreastObservation,
    r: FloatArray,
) -> FloatArray:
    """Return the derivative by a parameter that changes the path of the load."""
    h = FRICTION_STEP * (p["upper"] - p["lower"])
    value = constants[p["name"]]
    ahead = equilibrium(model, problem_of({**constants, p["name"]: value + h}), at)
    if not ahead.solution.outcome.converged:
        return np.zeros_like(r)
    moved, _ = _compare(observation, ahead)
    unit = value if logarithmic(p) else 1.0
    return (moved - r) / h * unit


def _shared(rest: Volume, loaded: Volume) -> list[Interface]:
    """Return the interfaces that both volumes show."""
    has_gland = all(bool((v.values == Tissue.GLANDULAR).any()) for v in (rest, loaded))
    return [OUTLINE, GLANDULAR] if has_gland else [OUTLINE]


def _covariance(points: InterfacePoints, noise: SegmentationNoise) -> FloatArray:
    """Return that of the noise, with what segmentations err by in common.

    See `workers.diagnosis.calibration.with_common_error`.
    """
    same = points.interface[:, None] == points.interface
    common = (SETTINGS.noise.common * noise.sd_mm) ** 2 * same
    length = SETTINGS.noise.smoother_lengths * noise.correlation_mm
    smoother = (SETTINGS.noise.smoother * noise.sd_mm) ** 2 * correlation(points, length)
    return covariance(points, noise, 1) + common + smoother


def _in_words(noise: SegmentationNoise) -> str:
    drawn = f", {noise.reference_sd_mm:.2g} mm of the body at rest" if noise.reference_sd_mm else ""
    return (
        f"{noise.sd_mm:.2g} mm along the normal of the target's interfaces{drawn}, alike over "
        f"{noise.correlation_mm:.2g} mm, and {noise.nugget_mm:.2g} mm at each point"
    )
