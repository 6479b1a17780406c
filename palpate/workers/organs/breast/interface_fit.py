"""Signed distances between the interfaces of a simulated breast and its image, and tangents.

The residuals are the same as in a diagnosis: points on the outline and on the gland of the body at
rest, moved by the model and compared with the same interface of the target. The error due to voxels
and smoothing of an interface is subtracted: the distance of the same points from the interface in
the model's own voxel image, which is made in the same way as the target.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, FreeParameter, Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    Interface,
    InterfacePoints,
    interface_points,
    observe,
    residual,
)
from palpate.workers.comparison.observation.segmentation_noise import (
    SegmentationNoise,
    correlation,
    covariance,
)
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.linearisation import factored
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem, Solution, frame_of
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.equilibrium_sensitivity import tangents
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.organs.breast.scan_facts import (
    NUGGET_VOXELS,
    in_air,
    in_coarser_voxels,
    study_noise,
)
from palpate.workers.organs.normal_equations import normal_equations
from palpate.workers.organs.organ_protocol import Residuals, either_side, logarithmic

# Distance of neighbouring points: a breast of 445 ml then has about 2,000.
SPACING_MM = 4.0
# Difference of a parameter for its derivative: of its logarithm, or relative to the interval.
STEP = 1e-4
# Minimum voxel size for interfaces: with a tenth of the voxels of 0.2 mm an interface is still
# smooth below a tenth of a millimetre, and found 30 times faster.
FINEST_MM = 0.5
# Points farther from their own interface do not count, such as those on merging strands.
OWN_BAND_MM = 4.0
# Voxel error of an interface that the model has moved, in voxels: points of ten bodies of 1 mm
# voxels scatter by 0.13 mm to 0.23 mm, by the median.
MOVED_INTERFACE_VOXELS = 0.14
# Standard deviation of the position of a plane anywhere within a voxel: 1 / sqrt(12).
PLATE_VOXELS = 0.29
# Difference for a path-dependent effect: friction is steepest at zero and then saturates.
PATH_STEP = 0.02
# Parameters of effects on the observation, which move points and change no problem.
OBSERVED = {name: e for e in CATALOGUE.on_observation for name in e.names}
# Parameters of path-dependent effects, for which tangents only cover the last load step.
STEPPED = {name for e in CATALOGUE.effects if e.follows_path for name in e.names}


@dataclass(frozen=True, eq=False)
class BreastObservation:
    """Data of body and target for computing residuals.

    Parameters
    ----------
    points : InterfacePoints
        The k points on the interfaces at rest.
    at_points : csr_matrix, shape (k, n)
        Interpolates displacements of the nodes to the points.
    compare : callable
        Returns signed distances of moved points, (k,) in mm, and their derivatives, (k, 3).
    own_image : callable
        Returns signed distances of the moved points from the interfaces of the body's own voxel
        image, for displacements of the nodes.
    whiten : callable
        Converts values at the points, (k,) or (k, c), to units of their noise.
    faces_mm : tuple of float
        Smallest and largest y of the target, and its voxel size.
    robust : bool
        Whether large residuals count less.
    noise : str
        The noise in words.
    """

    points: InterfacePoints
    at_points: csr_matrix
    compare: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    own_image: Callable[[FloatArray], FloatArray]
    whiten: Callable[[FloatArray], FloatArray]
    faces_mm: tuple[float, float, float]
    robust: bool
    noise: str


@dataclass(frozen=True, eq=False)
class FittedBreast:
    """Solution and residuals of a breast; see `workers.organs.organ_protocol.Fitted`."""

    solution: Solution
    residuals: Residuals | None


ProblemOf = Callable[[Mapping[str, float]], Problem]


def observe_target(
    body: Volume, mesh: Hierarchy, target: Volume, imaged: bool
) -> BreastObservation:
    """Place points on the interfaces of a body and find the same interfaces in its target.

    Raises
    ------
    InputError
        If body and target share no interface.
    """
    lattice = in_coarser_voxels(target, FINEST_MM)
    rest, loaded = in_air(in_coarser_voxels(body, FINEST_MM)), in_air(lattice)
    noise = study_noise(rest, loaded, imaged=imaged)
    interfaces = _shared(rest, loaded)
    margin = SETTINGS.points.wall_margin_mm
    clear_mm = SETTINGS.points.clear_noises * noise.sd_mm
    points = interface_points(rest, interfaces, SPACING_MM, margin, clear_mm)
    y = np.flatnonzero((loaded.values != Tissue.AIR).any(axis=(0, 2))) * loaded.spacing_mm[1]
    half = loaded.spacing_mm[1] / 2
    low, high = (float(v) + loaded.origin_mm[1] for v in (y.min() - half, y.max() + half))
    at_points = interpolation_at_points(mesh.finest.mesh, points.points)

    def own_image(u: FloatArray) -> FloatArray:
        image = in_air(warp_labels(body, mesh.finest.mesh, u, lattice))
        shown = observe(image, _shared(image, loaded), band_mm=OWN_BAND_MM)
        distances, _ = residual(points.points + at_points @ u, points, shown)
        return np.clip(distances, -OWN_BAND_MM, OWN_BAND_MM)

    return BreastObservation(
        points=points,
        at_points=at_points,
        own_image=own_image,
        compare=partial(residual, points=points, observed=observe(loaded, interfaces)),
        whiten=_whitening(points, noise, imaged),
        faces_mm=(low, high, loaded.spacing_mm[1]),
        robust=not imaged,
        noise=_in_words(noise, imaged),
    )


def fit_interfaces(
    model: Model,
    problem_of: ProblemOf,
    constants: Mapping[str, float],
    free: Sequence[FreeParameter],
    observation: BreastObservation,
) -> FittedBreast:
    """Deform a breast and differentiate its residuals; see `Organ.fit`."""
    solved = equilibrium(model, problem_of(constants))
    if not solved.solution.outcome.converged:
        return FittedBreast(solved.solution, None)
    r, normals = _compare(observation, solved)
    r = r - observation.own_image(solved.solution.displacement_mm)
    columns = np.empty((len(r), len(free)))
    moved = observation.points.points + observation.at_points @ solved.solution.displacement_mm
    seen = [i for i, p in enumerate(free) if p["name"] in OBSERVED]
    for i in seen:
        columns[:, i] = _observed(free[i]["name"], moved, normals, observation, model)
    stepped = {i for i, p in enumerate(free) if p["name"] in STEPPED}
    smooth = [i for i in range(len(free)) if i not in stepped.union(seen)]
    changes = [_change(solved, problem_of, constants, free[i]) for i in smooth]
    for i, nodal in zip(smooth, tangents(solved, changes), strict=True):
        columns[:, i] = ((observation.at_points @ nodal) * normals).sum(axis=1)
    for i in stepped:
        columns[:, i] = _by_solving(model, solved, problem_of, constants, free[i], observation)
    common = PLATE_VOXELS * _plates(observation, moved, normals)
    equations = normal_equations(
        observation.whiten(r),
        observation.whiten(columns),
        observation.whiten(common),
        robust=observation.robust,
    )
    return FittedBreast(solved.solution, Residuals(r, equations, observation.noise))


def _observed(
    name: str, moved: FloatArray, normals: FloatArray, observation: BreastObservation, model: Model
) -> FloatArray:
    """Return the derivatives of the residuals with respect to a parameter of the observation."""
    effect: Effect = OBSERVED[name]
    if effect.observation is None:
        raise AssertionError(f"{effect.name} changes the problem, not the observation")
    frame = frame_of(model.finest.nodes)
    shift = effect.observation(moved, normals, observation.points.interface, frame)
    return np.asarray(-shift[:, effect.names.index(name)])


def _plates(observation: BreastObservation, moved: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the voxel size in mm for points on the flat faces under the plates, (k, 2); else 0.

    Plates parallel to a plane of voxels shift a whole face by up to half a voxel. The transition to
    the rest of the outline is smooth, so the residuals are smooth too.
    """
    low, high, voxel = observation.faces_mm
    faces = []
    for side, face in ((-1.0, low), (1.0, high)):
        flat = np.clip((side * normals[:, 1] - 0.9) / 0.08, 0.0, 1.0)
        near = np.clip(2.0 - np.abs(moved[:, 1] - face) / voxel, 0.0, 1.0)
        outline = observation.points.interface == 0
        faces.append(voxel * flat * near * outline)
    return np.stack(faces, axis=1)


def _compare(observation: BreastObservation, at: Equilibrium) -> tuple[FloatArray, FloatArray]:
    moved = observation.at_points @ at.solution.displacement_mm
    return observation.compare(observation.points.points + moved)


def _change(
    at: Equilibrium, problem_of: ProblemOf, constants: Mapping[str, float], p: FreeParameter
) -> Change:
    """Return the problems on either side of a value, or on one side at a bound of zero."""
    ahead, behind, step = either_side(p, constants[p["name"]], STEP)
    plus = problem_of({**constants, p["name"]: ahead})
    minus = at.problem if behind is None else problem_of({**constants, p["name"]: behind})
    return Change(plus, minus, step)


def _by_solving(
    model: Model,
    at: Equilibrium,
    problem_of: ProblemOf,
    constants: Mapping[str, float],
    p: FreeParameter,
    observation: BreastObservation,
) -> FloatArray:
    """Return the derivative with respect to a path-dependent parameter."""
    h = PATH_STEP * (p["upper"] - p["lower"])
    value = constants[p["name"]]
    ahead = equilibrium(model, problem_of({**constants, p["name"]: value + h}), at)
    if not ahead.solution.outcome.converged:
        return np.zeros(len(observation.points))
    r, _ = _compare(observation, at)
    moved, _ = _compare(observation, ahead)
    unit = value if logarithmic(p) else 1.0
    return (moved - r) / h * unit


def _shared(rest: Volume, loaded: Volume) -> list[Interface]:
    """Return the interfaces present in both volumes."""
    has_gland = all(bool((v.values == Tissue.GLANDULAR).any()) for v in (rest, loaded))
    return [OUTLINE, GLANDULAR] if has_gland else [OUTLINE]


def _whitening(
    points: InterfacePoints, noise: SegmentationNoise, imaged: bool
) -> Callable[[FloatArray], FloatArray]:
    """Return a function that whitens values at the points.

    The voxel error of an interface is independent between points. For images the covariance of the
    segmentation is used, including common errors; see `workers.diagnosis.problem.scan_noise`.
    """
    if not imaged:
        sd = float(
            np.hypot(MOVED_INTERFACE_VOXELS * noise.nugget_mm / NUGGET_VOXELS, noise.nugget_mm)
        )
        return partial(np.multiply, 1 / sd)
    same = points.interface[:, None] == points.interface
    common = (SETTINGS.noise.common * noise.sd_mm) ** 2 * same
    length = SETTINGS.noise.smoother_lengths * noise.correlation_mm
    smoother = (SETTINGS.noise.smoother * noise.sd_mm) ** 2 * correlation(points, length)
    factor = factored(covariance(points, noise, 1) + common + smoother)
    return partial(solve_triangular, factor, lower=True, check_finite=False)


def _in_words(noise: SegmentationNoise, imaged: bool) -> str:
    plates = "and a third of a voxel of the flat faces under the plates"
    if not imaged:
        voxel = noise.nugget_mm / NUGGET_VOXELS
        sd = voxel * np.hypot(MOVED_INTERFACE_VOXELS, NUGGET_VOXELS)
        return f"{sd:.2g} mm at each point {plates}"
    return (
        f"{noise.sd_mm:.2g} mm along the normal of the target's interfaces and of those at rest, "
        f"correlated over {noise.correlation_mm:.2g} mm, {noise.nugget_mm:.2g} mm at each point "
        f"{plates}"
    )
