"""Inverse problem of a diagnosis: a body, its scans, and a model with unknown constants.

Its equilibria come from a forward solver: tetrahedra, unless an organ provides its own model.

Force readings are among its points. A load cell is represented by a point whose displacement is the
measured force, in units chosen by the organ, with one additional node far from all others. Its
residual counts in every fit, but not in any gap in mm, because it is not a distance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.sparse import block_diag, csr_matrix, eye_array

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Triple
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS, FieldSettings
from palpate.workers.diagnosis.linearisation import factored
from palpate.workers.diagnosis.noise.noise_components import LearntNoise
from palpate.workers.mechanics.effects.effect import Effect, one_sided
from palpate.workers.mechanics.fem import body_equilibrium, equilibrium_sensitivity
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.model_parameters import KPA, Unit

FORCE = 3
"""Interface number of force readings, beyond those of any organ."""


def at_points_with_forces(own: csr_matrix, readings: int) -> csr_matrix:
    """Extend the interpolation matrix of points by rows for a number of force readings."""
    return csr_matrix(block_diag([own, eye_array(readings)])) if readings else own


class Forward(Protocol):
    """A solver for one kind of problem; its return values are passed back to it unchanged."""

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> Any:
        """Return an equilibrium with its ``solution``; see `mechanics.fem.equilibrium.solve`."""

    def expecting(self, at: Any, moved_mm: FloatArray) -> Any:
        """Return an equilibrium as a start, with nodes expected to move by `moved_mm`."""

    def tangents(self, at: Any, changes: Sequence[Any], tolerance: float) -> FloatArray:
        """Return derivatives of the displacement; see `mechanics.fem.equilibrium.sensitivity`."""

    def loosened(self, problem: Any, tolerance_mm: float, friction_steps: int) -> Any:
        """Return the problem with a coarser tolerance and fewer steps, if applicable.

        If no equilibrium is found from a nearby one, there are no further attempts.
        """

    def direction(self, problem: Any) -> Sequence[float]:
        """Return the direction (x, y, z) in which the body is loaded."""

    def pressed(self, at: Any) -> BoolArray | None:
        """Return a mask of the nodes that a plate presses, shape (n,); None without plates."""


class Tetrahedra:
    """The solver of `workers.mechanics.fem`; see `Forward`."""

    def equilibrium(self, model: Any, problem: Any, start: Any = None) -> Any:
        """See `Forward.equilibrium`."""
        return body_equilibrium.equilibrium(model, problem, start)

    def tangents(self, at: Any, changes: Sequence[Any], tolerance: float) -> FloatArray:
        """See `Forward.tangents`."""
        return equilibrium_sensitivity.tangents(at, changes, tolerance)

    def expecting(self, at: Any, moved_mm: FloatArray) -> Any:
        """See `Forward.expecting`."""
        return at.expecting(moved_mm)

    def loosened(self, problem: Any, tolerance_mm: float, friction_steps: int) -> Any:
        """See `Forward.loosened`."""
        return replace(
            problem,
            tolerance_mm=max(problem.tolerance_mm, tolerance_mm),
            friction_steps=min(problem.friction_steps, friction_steps),
            restarts=False,
        )

    def direction(self, problem: Any) -> Sequence[float]:
        """See `Forward.direction`."""
        axis: Sequence[float] = problem.load.device.axis
        return axis

    def pressed(self, at: Any) -> BoolArray | None:
        """See `Forward.pressed`."""
        level, found = at.levels[-1], np.zeros(len(at.states[-1].x), np.bool_)
        for contact in level.plate_contacts(at.states[-1], at.stage):
            found[contact.nodes.index[contact.gap < 0]] = True
        return found


Values = Mapping[str, float]
Compare = Callable[[FloatArray, InterfacePoints], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class FreeConstant:
    """A constant of the model that the scans must determine.

    Parameters
    ----------
    name : str
    lower, upper : float
        Plausible interval in internal units, both > 0. The logarithm has a normal prior; the
        interval is its mean plus or minus one standard deviation.
    unit : Unit
        External unit.
    is_bound : bool
        Whether the interval also bounds the fit.
    """

    name: str
    lower: float
    upper: float
    unit: Unit = KPA
    is_bound: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.lower < self.upper:
            raise InputError(
                f"The plausible interval of {self.name} must be positive and in ascending order, "
                f"found [{self.lower:g}, {self.upper:g}]."
            )

    @property
    def log_mean(self) -> float:
        """Prior mean of the logarithm."""
        return float(np.log(self.lower * self.upper) / 2)

    @property
    def log_sd(self) -> float:
        """Prior standard deviation of the logarithm."""
        return float(np.log(self.upper / self.lower) / 2)


@dataclass(frozen=True, eq=False)
class FollowedPoints:
    """Points on the interfaces that move with the mesh of the body.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Positions at rest, in mm.
    at_points : csr_matrix, shape (k, n)
        Interpolation of nodal displacements to the points.
    pressed : ndarray, shape (k,)
        Pressed share of each point, 0 to 1; see `workers.diagnosis.problem.scan_noise`.
    """

    points: FloatArray
    at_points: csr_matrix
    pressed: FloatArray

    def moved(self, displacement_mm: FloatArray) -> FloatArray:
        """Return the positions of the points, (k, 3), for nodal displacements (n, 3)."""
        return np.asarray(self.points + self.at_points @ displacement_mm)


@dataclass(frozen=True, eq=False)
class Scan:
    """The observed body in one loaded state, and the problem of that load.

    Parameters
    ----------
    name : str
    problem : callable
        Builds the problem from values of the free constants.
    compare : callable
        Takes moved points, (k, 3), and the reference points; returns residuals, (k,) in mm, and
        their derivatives with respect to the positions, (k, 3).
    drawn : callable, optional
        Like `compare`, for the interfaces as drawn, if `compare` uses noise fixed at an anchor; see
        `workers.diagnosis.problem.scan_noise`.
    interface_mm2 : sequence of float
        Area of each interface in the scan; empty for markers.
    voxel_mm : tuple of float, optional
        Voxel size along x, y and z, if the scan has labels.
    followed : FollowedPoints, optional
        Points as followed under this load, if plates press some of the points.
    """

    name: str
    problem: Callable[[Values], Problem]
    compare: Compare
    drawn: Compare | None = None
    interface_mm2: Sequence[float] = ()
    voxel_mm: Triple | None = None
    followed: FollowedPoints | None = None


@dataclass(frozen=True, eq=False)
class InverseProblem:
    """A body and its scans, with a model whose constants are unknown.

    Parameters
    ----------
    model : Model
    frame : Frame
    points : InterfacePoints
        The k points on the interfaces of the reference scan.
    at_points : csr_matrix, shape (k, n)
        Interpolation of nodal displacements to the points.
    free : sequence of FreeConstant
    scans : sequence of Scan
    noise : SegmentationNoise
    covariance : ndarray, shape (s k, s k)
        Noise covariance of the concatenated residuals of all scans, in mm^2; without poses, whose
        columns belong to a fit.
    bias : ndarray, shape (s k,)
        Mesh error of the residuals, in mm, which is subtracted from them.
    is_segmented : bool
        Whether residuals are distances to segmented interfaces, whose noise is learnt and whose
        scans may deviate from the poses in their headers. False for markers, whose noise was
        measured.
    learnt : LearntNoise, optional
        The noise found by the calibration, which `covariance` then contains.
    anchors : sequence of ndarray, shape (k, 3)
        Positions at which the noise of each scan was evaluated; see
        `workers.diagnosis.problem.scan_noise`. Empty before the calibration.
    arms : csr_matrix, shape (k, n), optional
        Maps nodal displacements to the displacement of the end of an arm, 1 mm long and
        perpendicular to the surface at the point, relative to its foot. None without markers.
    pose_sd : tuple of float
        Prior standard deviation of a scan's pose relative to its header: along each axis in mm,
        about each axis in degrees.
    left_out : int
        Number of points removed because they are not clearly visible in some scan.
    forward : Forward
    something_else : FieldSettings
        Prior of the smooth field for unlisted causes.
    """

    model: Model
    frame: Frame
    points: InterfacePoints
    at_points: csr_matrix
    free: Sequence[FreeConstant]
    scans: Sequence[Scan]
    noise: SegmentationNoise
    covariance: FloatArray
    bias: FloatArray
    arms: csr_matrix | None = None
    is_segmented: bool = True
    learnt: LearntNoise | None = None
    anchors: Sequence[FloatArray] = ()
    pose_sd: tuple[float, float] = (SETTINGS.pose.shift_sd_mm, SETTINGS.pose.turn_sd_deg)
    left_out: int = 0
    forward: Forward = field(default_factory=Tetrahedra)
    something_else: FieldSettings = SETTINGS.smooth_field

    @cached_property
    def covariance_factor(self) -> FloatArray:
        """Lower Cholesky factor of the covariance."""
        return factored(self.covariance)

    @cached_property
    def scatter_factor(self) -> FloatArray:
        """Lower Cholesky factor excluding the contour bias, whose columns are in `drawing`."""
        if self.learnt is None:
            return self.covariance_factor
        return factored(self.learnt.scatter)

    @property
    def drawing(self) -> FloatArray:
        """Columns of contour bias, per prior sd, shape (s k, q), in mm."""
        if self.learnt is None:
            return np.zeros((len(self.bias), 0))
        return self.learnt.fixed

    @property
    def has_poses(self) -> bool:
        """Whether scans may deviate from the poses in their headers."""
        return self.learnt is not None and self.is_segmented

    @property
    def nuisance_count(self) -> int:
        """Number of columns of poses and contour bias in a fit."""
        poses = 6 * len(self.scans) if self.has_poses else 0
        return poses + self.drawing.shape[1]

    def followed(self, scan: Scan) -> FollowedPoints:
        """Return the points as followed under the load of a scan."""
        free = FollowedPoints(self.points.points, self.at_points, np.zeros(len(self.points)))
        return scan.followed or free

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors of the load direction in each scan, shape (s, 3)."""
        middle = {one.name: float(np.exp(one.log_mean)) for one in self.free}
        found = np.array([self.forward.direction(scan.problem(middle)) for scan in self.scans])
        return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])

    @property
    def is_force(self) -> BoolArray:
        """Mask of the points that are force readings, which have no gap in mm, shape (k,)."""
        return np.asarray(self.points.interface == FORCE)

    @property
    def is_place(self) -> BoolArray:
        """Mask of the residuals that are distances, shape (s k,)."""
        return np.tile(~self.is_force, len(self.scans))

    @cached_property
    def rows(self) -> IntArray:
        """Index of the scan of each residual, shape (s k,)."""
        return np.repeat(np.arange(len(self.scans), dtype=np.int32), len(self.points))

    def keeping(self, which: BoolArray) -> "InverseProblem":
        """Return the problem with a subset of the points."""
        index = np.flatnonzero(which)
        rows = np.concatenate([index + s * len(which) for s in range(len(self.scans))])
        return replace(
            self,
            points=self.points.of(index),
            at_points=self.at_points[index],
            covariance=self.covariance[np.ix_(rows, rows)],
            bias=self.bias[rows],
            arms=None if self.arms is None else self.arms[index],
            left_out=self.left_out + int(np.sum(~which)),
        )


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The parameters of a hypothesis: logarithms of the constants, then effect parameters.

    Parameters
    ----------
    free : sequence of FreeConstant
    effects : sequence of Effect
    mean, sd : ndarray, shape (p,)
        Prior means and standard deviations, including those of an effect's location.
    """

    free: Sequence[FreeConstant]
    effects: Sequence[Effect]
    mean: FloatArray
    sd: FloatArray

    @property
    def names(self) -> list[str]:
        """Names of all parameters, in order."""
        return [f.name for f in self.free] + [n for e in self.effects for n in e.names]

    @property
    def lower(self) -> FloatArray:
        """Smallest admissible values; zero for one-sided parameters."""
        return self._ends()[0]

    @property
    def upper(self) -> FloatArray:
        """Largest admissible values, at most four prior standard deviations away."""
        return self._ends()[1]

    @property
    def one_sided(self) -> BoolArray:
        """Mask of the parameters with a half-normal prior."""
        sides = [False] * len(self.free)
        for e in self.effects:
            sides += [one_sided(p) and not e.if_present for p in e.parameters]
        return np.array(sides)

    def at_bound(self, z: FloatArray) -> IntArray:
        """Mark the parameters at a bound: 1 at a lower bound, -1 at an upper bound, 0 otherwise.

        The neutral value of a one-sided parameter is not a bound, because its prior ends there.
        """
        lower = (z <= self.lower) & ~self.one_sided
        return lower.astype(np.int32) - (z >= self.upper)

    def constants(self, z: FloatArray) -> dict[str, float]:
        """Return the values of the free constants at `z`."""
        return {f.name: float(np.exp(v)) for f, v in zip(self.free, z, strict=False)}

    def of_effect(self, effect: Effect, z: FloatArray) -> dict[str, float]:
        """Return the values of one effect's parameters at `z`."""
        at = self.names.index(effect.names[0])
        return dict(zip(effect.names, map(float, z[at : at + len(effect.names)]), strict=True))

    def _ends(self) -> tuple[FloatArray, FloatArray]:
        reach = 4 * self.sd
        lower, upper = self.mean - reach, self.mean + reach
        for i, constant in enumerate(self.free):
            if constant.is_bound:
                lower[i], upper[i] = np.log(constant.lower), np.log(constant.upper)
        k = len(self.free)
        for p in (p for e in self.effects for p in e.parameters):
            lower[k] = max(lower[k], p.admissible[0] + (1e-9 if p.open_lower else 0.0))
            upper[k] = min(upper[k], p.admissible[1])
            k += 1
        return lower, upper


def unknowns(free: Sequence[FreeConstant], effects: Sequence[Effect]) -> Unknowns:
    """Return the parameters of the hypothesis with the given effects."""
    mean, sd = [f.log_mean for f in free], [f.log_sd for f in free]
    for effect in effects:
        present = effect.if_present or tuple(
            zip(effect.neutral.values(), effect.prior_sd, strict=True)
        )
        for middle, scale in present:
            mean.append(middle)
            sd.append(scale)
    return Unknowns(free, effects, np.array(mean), np.array(sd))
