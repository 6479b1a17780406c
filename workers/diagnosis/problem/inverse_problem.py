"""What is diagnosed: a body, its scans, and a model of it with constants to be found."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Triple
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.comparison.observation.noise import SegmentationNoise
from palpate.workers.diagnosis.algebra.linearisation import factored
from palpate.workers.diagnosis.noise.model import LearntNoise
from palpate.workers.diagnosis.problem.force_readings import FORCE
from palpate.workers.diagnosis.problem.forward import Forward, Tetrahedra
from palpate.workers.diagnosis.settings.values import SETTINGS, FieldSettings
from palpate.workers.mechanics.effects.base import Effect, one_sided
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.units import KPA, Unit

Values = Mapping[str, float]
Compare = Callable[[FloatArray, InterfacePoints], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class FreeConstant:
    """A constant of the model that the scans must determine.

    Parameters
    ----------
    name : str
    lower, upper : float
        Where it plausibly lies, inside units, both > 0. Its logarithm has a normal
        prior, with the interval as mean and standard deviation.
    unit : Unit
        At the door.
    is_bound : bool
        Whether the interval bounds the fit, too.
    """

    name: str
    lower: float
    upper: float
    unit: Unit = KPA
    is_bound: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.lower < self.upper:
            raise InputError(
                f"The plausible interval of {self.name} must be positive and ascending, "
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
    """Points of the interfaces as the mesh of the body carries them along.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        At rest, in mm.
    at_points : csr_matrix, shape (k, n)
        From displacements of the nodes to those of the points.
    pressed : ndarray, shape (k,)
        How far each is on a plate, 0 to 1; see `workers.diagnosis.problem.pressed_points`.
    """

    points: FloatArray
    at_points: csr_matrix
    pressed: FloatArray

    def moved(self, displacement_mm: FloatArray) -> FloatArray:
        """Return where points are under a displacement of the nodes (n, 3), shape (k, 3)."""
        return np.asarray(self.points + self.at_points @ displacement_mm)


@dataclass(frozen=True, eq=False)
class Scan:
    """The body in one loaded state: what was observed, and the problem of that load.

    Parameters
    ----------
    name : str
    problem : callable
        From values of the free constants.
    compare : callable
        From moved points, (k, 3), and the points of the reference to residuals, (k,) in
        mm, and their derivatives by the place of the point, (k, 3).
    drawn : callable, optional
        The same for interfaces as they were drawn, where `compare` has their noise from
        elsewhere; see `workers.diagnosis.problem.anchored_scan`.
    interface_mm2 : sequence of float
        Area of each interface that the scan shows; none where it shows markers.
    voxel_mm : tuple of float, optional
        Edges of its voxels along x, y and z, where it shows labels.
    followed : FollowedPoints, optional
        How the points are followed under this load, where plates press some of them.
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
    """A body and its scans.

    Parameters
    ----------
    model : Model
    frame : Frame
    points : InterfacePoints
        On the interfaces of the reference scan, k of them.
    at_points : csr_matrix, shape (k, n)
        From displacements of the nodes to those of the points.
    free : sequence of FreeConstant
    scans : sequence of Scan
    noise : SegmentationNoise
    covariance : ndarray, shape (s k, s k)
        Of the noise of the residuals of all scans, one after another, in mm^2; without poses,
        whose columns belong to a fit.
    bias : ndarray, shape (s k,)
        What the mesh adds to the residuals, in mm; subtracted.
    is_segmented : bool
        Whether residuals are distances to interfaces that somebody has drawn: their noise is
        then learnt, and a scan may lie elsewhere than its header says. Not for markers, whose
        noise was measured.
    learnt : LearntNoise, optional
        The noise as the calibration has found it; `covariance` then is its likeliest one.
    anchors : sequence of ndarray, shape (k, 3)
        Where the noise of each scan was read; see `workers.diagnosis.problem.anchored_scan`. None
        before the calibration.
    arms : csr_matrix, shape (k, n), optional
        From displacements of the nodes to those of the end of an arm of 1 mm, which
        stands on the surface at the point, less those of its foot. None where no point
        is a marker.
    pose_sd : tuple of float
        How far a scan may lie from where its header puts it: along each axis in mm, about each
        in degrees.
    left_out : int
        Points that are not among `points` any more, because some scan does not show them clearly.
    forward : Forward
    something_else : FieldSettings
        Prior of the field that stands for what is not in the catalogue.
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
        """The same without drawing, which `drawing` has as columns."""
        if self.learnt is None:
            return self.covariance_factor
        return factored(self.learnt.scatter)

    @property
    def drawing(self) -> FloatArray:
        """Columns of interfaces drawn too large, per prior sd, shape (s k, q), in mm."""
        if self.learnt is None:
            return np.zeros((len(self.bias), 0))
        return self.learnt.parts.fixed

    @property
    def has_poses(self) -> bool:
        """Whether scans may lie elsewhere than their headers say."""
        return self.learnt is not None and self.is_segmented

    @property
    def nuisance_count(self) -> int:
        """How many columns of poses and drawing a fit has."""
        poses = 6 * len(self.scans) if self.has_poses else 0
        return poses + self.drawing.shape[1]

    def followed(self, scan: Scan) -> FollowedPoints:
        """Return how the points are followed under the load of a scan."""
        free = FollowedPoints(self.points.points, self.at_points, np.zeros(len(self.points)))
        return scan.followed or free

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors along which the body is loaded in each scan, shape (s, 3)."""
        middle = {one.name: float(np.exp(one.log_mean)) for one in self.free}
        found = np.array([self.forward.direction(scan.problem(middle)) for scan in self.scans])
        return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])

    @property
    def is_force(self) -> BoolArray:
        """Which points are readings of forces, of which there is no gap in mm, shape (k,)."""
        return np.asarray(self.points.interface == FORCE)

    @property
    def is_place(self) -> BoolArray:
        """Which residuals are distances, shape (s k,)."""
        return np.tile(~self.is_force, len(self.scans))

    @cached_property
    def rows(self) -> IntArray:
        """The scan of each residual, shape (s k,)."""
        return np.repeat(np.arange(len(self.scans), dtype=np.int32), len(self.points))

    def keeping(self, which: BoolArray) -> "InverseProblem":
        """Return the problem with some of the points only."""
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
    """The parameters of a hypothesis: logarithms of the constants, then those of effects.

    Parameters
    ----------
    free : sequence of FreeConstant
    effects : sequence of Effect
    mean, sd : ndarray, shape (p,)
        Prior. An effect's place has its own.
    """

    free: Sequence[FreeConstant]
    effects: Sequence[Effect]
    mean: FloatArray
    sd: FloatArray

    @property
    def names(self) -> list[str]:
        """Of all parameters, in order."""
        return [f.name for f in self.free] + [n for e in self.effects for n in e.names]

    @property
    def lower(self) -> FloatArray:
        """Least admissible values: one-sided parameters begin at zero."""
        return self._ends()[0]

    @property
    def upper(self) -> FloatArray:
        """Largest admissible values, four prior standard deviations away at most."""
        return self._ends()[1]

    @property
    def one_sided(self) -> BoolArray:
        """Which parameters have a half-normal prior."""
        sides = [False] * len(self.free)
        for e in self.effects:
            sides += [one_sided(p) and not e.if_present for p in e.parameters]
        return np.array(sides)

    def at_bound(self, z: FloatArray) -> IntArray:
        """Return which parameters lie at a bound: 1 at a lower, -1 at an upper one, else 0.

        The neutral value of a one-sided one is none: its prior ends there.
        """
        lower = (z <= self.lower) & ~self.one_sided
        return lower.astype(np.int32) - (z >= self.upper)

    def constants(self, z: FloatArray) -> dict[str, float]:
        """Return values of the free constants at `z`."""
        return {f.name: float(np.exp(v)) for f, v in zip(self.free, z, strict=False)}

    def of_effect(self, effect: Effect, z: FloatArray) -> dict[str, float]:
        """Return values of the parameters of one effect at `z`."""
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


def unknowns(
    free: Sequence[FreeConstant], effects: Sequence[Effect], means: Values | None = None
) -> Unknowns:
    """Return the parameters of the hypothesis that `effects` act.

    Parameters
    ----------
    means : mapping of str to float, optional
        Prior means that are not the neutral values: the place of a lump.
    """
    mean, sd = [f.log_mean for f in free], [f.log_sd for f in free]
    for effect in effects:
        present = effect.if_present or tuple(
            zip(effect.neutral.values(), effect.prior_sd, strict=True)
        )
        for name, (middle, scale) in zip(effect.names, present, strict=True):
            mean.append((means or {}).get(name, middle))
            sd.append(scale)
    return Unknowns(free, effects, np.array(mean), np.array(sd))
