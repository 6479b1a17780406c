"""All numbers on which a verdict depends, in one frozen value, with their sources.

Sources are named in brackets: [principle] follows from theory or is a convention of statistics;
[prior] was assumed before any data; [numerics] is an accuracy or a bound of an algorithm; [cost]
limits computation; [null replicates] was set on bodies without any missing effect, drawn by the
blind solver with seeds that no sealed set uses; [set 4], [hard set 5] were set after those blind
sets had been opened, so these sets do not test them; [open cases] was set while looking at the open
cases of FEBio; [by hand] was chosen when that part was written, without a record of the reason.

The first groups concern errors other than missing effects: segmentation, poses, numerics and form.
Model errors of two states of a body are correlated, but not fully: plates that press in another
direction touch and bend other parts of the body, where a mesh error or a missing cause produces a
different displacement.

The seal of a blind set contains this whole value; see `sealed_diagnosis`. Constants
that only affect drawings are in `workers.diagnosis.outcome`.
"""

from dataclasses import dataclass, field

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


@dataclass(frozen=True, slots=True)
class StateCorrelation:
    """Correlation of a displacement between two states.

    Parameters
    ----------
    along : float
        Correlation for two loads in the same direction, 0 to 1.
    across : float
        Correlation for two loads at right angles; no larger than `along`.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    along: float
    across: float

    def __post_init__(self) -> None:
        if not 0 <= self.across <= self.along <= 1:
            raise InputError(
                "A correlation between states needs 0 <= across <= along <= 1, found "
                f"along = {self.along}, across = {self.across}."
            )

    def between(self, directions: FloatArray) -> FloatArray:
        """Return the correlations of all pairs of states, shape (s, s), with ones on the diagonal.

        Between parallel and perpendicular directions, it varies with the squared cosine, which
        keeps the matrix positive semi-definite.

        Parameters
        ----------
        directions : ndarray, shape (s, 3)
            Unit vectors of the load direction of each state.
        """
        squares = (directions @ directions.T) ** 2
        found = self.across + (self.along - self.across) * squares
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Settings of segmentation errors in addition to the given noise."""

    # [null replicates, set 2] Standard deviation of the bias of a whole interface, drawn too large
    # or too small, in standard deviations of the segmentation: points were chosen on one noisy
    # scan. On bodies without a missing effect, means over an interface and all scans scatter by
    # 0.08 to 0.15 standard deviations in total.
    common: float = 0.1
    # [null replicates] Part of the noise of every scan, including the scan at rest, is smoother
    # than the given correlation length: its size in standard deviations, its length in correlation
    # lengths. On 30 bodies of the hard world without a missing effect, the errors of the scans
    # alone are likelier by 27 nats in total than with 0.25 and 3 and no such part at rest, where
    # noise of 0.3 mm and more has it; 0.3 to 0.35 and 2 to 2.5 are equally good.
    smoother: float = 0.30
    smoother_lengths: float = 2.5
    # [numerics] Neglected variance of the common error of flat faces, in mm^2; see
    # `workers.diagnosis.problem.scan_noise`.
    voxel_variance_mm2: float = 0.002
    # [numerics] Change of a scale's logarithm at which its fixed point has converged (some 1200
    # residuals determine it to within 0.02 or 0.03); maximum number of iterations; bounds of the
    # scales.
    scale_settled: float = 0.005
    scale_iterations: int = 12
    scale_bounds: tuple[float, float] = (0.2, 5.0)
    # [principle] Amplitude and length of the field that absorbs a possible gap while scales are
    # learnt: so large that the field is almost free, as otherwise the noise that it absorbs would
    # be missed.
    learning_field: tuple[float, float] = (1.0, 20.0)
    # [prior] Given or measured noise that differs from the learnt noise by this factor is reported.
    misstated: float = 1.25


@dataclass(frozen=True, slots=True)
class UnmatchedSettings:
    """Settings of unmatched points; see `diagnosis.noise.unmatched_points`."""

    # [principle] Factor on the displacement of an unlisted cause, which makes it almost free.
    freer: float = 4.0
    # [principle] Constants of Huber and Tukey, in standard deviations: 95 % efficient for normal
    # noise.
    huber: float = 1.345
    biweight: float = 4.685
    # [numerics] Change in a standard deviation at which the fit has converged; maximum number of
    # iterations.
    settled: float = 0.01
    iterations: int = 12
    # [principle] Noise is no smaller than this fraction of the given noise: half of it is possible.
    least_scale: float = 0.5
    # [principle] In robust deviations of an interface: a point as far off as the first value has no
    # counterpart; nor have points near it that are as far off as the second value, nor points as
    # far off as the second that, over all scans, are as improbable as the first. Among a thousand
    # points, normal noise reaches six deviations once in a million bodies.
    far: float = 6.0
    beside: float = 3.0
    # [by hand] Radius around a point, as a fraction of the middle length of the smooth field: 8 mm
    # in a breast.
    beside_lengths: float = 0.4
    # [by hand] A connected piece of at most this many points follows any fit, so it is compared
    # with all other points.
    small_piece: int = 12
    # [by hand] If more than this fraction of all points are far off, the segmentation is not the
    # cause.
    most: float = 0.1


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """Settings of the poses of the scans [prior]: registration errors."""

    shift_sd_mm: float = 0.3
    turn_sd_deg: float = 0.3
    # Bias of an interface in one scan, due to a habit or half a voxel, in standard deviations of
    # the segmentation.
    drawing: float = 0.3
    # [numerics] The pose of a scan is updated from its residuals until it changes by less than
    # this, in the standard deviations above: 0.003 mm; maximum number of updates; and the ratio to
    # the previous step above which a step is halved.
    settled: float = 0.01
    registrations: int = 12
    shorter: float = 0.7


@dataclass(frozen=True, slots=True)
class NumericalSettings:
    """Settings of the numerical error: another mesh, element or contact of the same physics."""

    # [open cases] Minimum for any solver, in mm; and the fraction of the nugget for voxels larger
    # than those of the open cases: the voxel error is the same all over a face parallel to voxels.
    least_mm: float = 0.03
    of_nugget: float = 0.75
    # [numerics] Fraction of the root mean square change due to a finer mesh in each scan: the error
    # that remains after correcting for that difference is as large as the difference itself.
    of_difference: float = 1.0
    # [sets 10 to 12, hard sets 7 to 9] Correlation length, and correlations of states with equal
    # and with perpendicular directions: the nominal model's true error on 16 bodies without a
    # missing effect, after fitting constants and poses, is likeliest with 10 to 12 mm, 0.94 and
    # -0.2. Slightly above zero across, because the voxel error of the scan at rest is in all scans.
    # [by hand] Lower for markers, whose states load the body in different ways.
    length_mm: float = 12.0
    state_correlation: StateCorrelation = field(default=StateCorrelation(along=0.94, across=0.1))
    state_correlation_markers: StateCorrelation = field(
        default=StateCorrelation(along=0.8, across=0.0)
    )
    # [numerics] Fraction of its variance that a low-rank factor may neglect.
    rank_tolerance: float = 0.3


@dataclass(frozen=True, slots=True)
class MeshSettings:
    """Settings of the body's meshes."""

    # [cost] Nodes of the working mesh: a verdict in a minute or two.
    nodes: int = 5000
    # [cost] Nodes of the mesh used to estimate the mesh error, relative to the working mesh:
    # elements are smaller by a factor of 2.8^(1/3) = 1.4.
    finer_ratio: float = 2.8
    # [gap-opened, gap-opened2] Standard deviation of the logarithm of a stiffness fitted to a body
    # that another solver deformed. FEBio's elements of 6 mm have the mean modulus of the tissues in
    # them: E_fat is 3 to 12 % larger in the fits, E_gl 1 to 8 % smaller. On our own meshes of
    # 50,000 nodes, the differences are 0.5 and 2 %.
    stiffness_sd: float = 0.06


@dataclass(frozen=True, slots=True)
class PointSettings:
    """Settings of the points on the interfaces at which model and scans are compared."""

    # [cost] Distance between neighbours; a breast then has some 900 points in each scan.
    spacing_mm: float = 6.0
    # [cost] With more loaded scans, points are sparser, for about the same number of residuals.
    scans_at_that_spacing: int = 2
    # [principle] Points this close to the chest wall are where the image was cropped.
    wall_margin_mm: float = 4.0
    # [principle] Minimum thickness of tissue on either side of a point in the reference scan, and
    # radius around its predicted position in a deformed scan that must not contain a second
    # interface, in standard deviations of the segmentation: within 5 of them, noise alone reaches
    # no other interface.
    clear_noises: float = 5.0
    # [by hand] Fraction of that radius by which the distance may differ, due to curvature and blur.
    clear_slack: float = 0.1
    # [numerics] Radii of the discs over which an interface is averaged, in correlation lengths of
    # the segmentation: the first, or the widest on which it is flat. Averaged over a disc of one
    # length, the noise keeps 0.6 of its slope; over a disc of two lengths, 0.3.
    discs: tuple[float, ...] = (0.7, 1.0, 1.4, 2.0)
    # [numerics] Rings of a disc, besides its centre: fractions of its radius, and the number of
    # points on each.
    disc: tuple[tuple[float, int], ...] = ((0.5, 6), (1.0, 8))
    # [numerics] Length of the averaged normal above which an interface counts as flat, and smallest
    # length that is rescaled to one.
    flat: float = 0.93
    least_slope: float = 0.5


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of the Gauss-Newton method."""

    # [numerics] Maximum number of iterations. Most fits take 3 to 6; along the valley of a law with
    # two similar terms, one took 23.
    max_iterations: int = 30
    # [numerics] The last trial of a line search is 0.4^7 = 0.002 of the initial step: the whole
    # step, or 1 / 0.4 of the last successful fraction.
    max_halvings: int = 8
    shortening: float = 0.4
    # [numerics] If a step lowers minus twice the log posterior by more than `underrated` times the
    # expected decrease, the next step starts `further` times longer: the linear model underrates
    # it.
    underrated: float = 1.5
    further: float = 2.0
    # [principle] A decrease in minus twice the log posterior below this changes no verdict: 0.025
    # nats.
    tolerance: float = 0.05
    # [cost] The same threshold for localised effects, a tenth of a nat: below that, the fit crawls
    # along a valley. A lump in an opened case took 11 iterations instead of 3 and lost 1.4 nats of
    # evidence, because the valley narrows.
    place_tolerance: float = 0.2
    # [principle] If no step decreases the cost, or only by less than the tolerance, the fit has
    # converged if the expected decrease was below this: half a nat.
    at_rest: float = 1.0
    # [cost] Number of successive steps with a decrease below the tolerance, although more was
    # expected, after which a fit ends without convergence.
    stalls: int = 2
    # [principle] The prior alone has a curvature of one: smaller curvatures suggested by earlier
    # steps are not reliable.
    least_curvature: float = 0.5
    # [numerics] Longest step of a parameter in prior standard deviations.
    longest_step: float = 1.5
    # [numerics] Relative error of tangents: for a tilt and a lump, 1e-5 changes the evidence by
    # less than 0.01 nats.
    tangent_error: float = 1e-4
    # [numerics] Step in the logarithm of a constant for its derivative.
    log_step: float = 1e-4
    # [by hand] Step in friction for its derivative, in prior standard deviations. The response to
    # friction is steepest at zero and then saturates, so the tangent at zero overestimates it
    # several-fold.
    friction_step: float = 0.2
    # [cost] Within this change, in the same unit, the derivative with respect to friction is
    # reused.
    friction_near: float = 0.15
    # [cost] Load steps when friction is fitted: for a coefficient of 0.04, four steps find 0.039,
    # eight 0.0394 and sixteen 0.0397; the evidence differs by 0.04 nats.
    friction_steps: int = 4


@dataclass(frozen=True, slots=True)
class SensitivitySettings:
    """Settings of the sensitivities of the nominal fit's residuals to effects."""

    # [cost] Spacing of places at which a lump is tried: no lump of 10 mm radius is missed.
    inside_grid_mm: float = 12.0
    # [principle] Minimum depth of these places inside the body: half a lump.
    inside_depth_mm: float = 6.0
    # [cost] Spacing of places on the boundary at which an attachment is tried, for its smallest
    # radius; proportionally larger for larger radii.
    boundary_grid_mm: float = 20.0
    # [by hand] Magnitudes at which a one-sided effect is tried, in prior standard deviations: a
    # plausible magnitude, and one near zero, where such effects are steepest.
    secant_magnitudes: tuple[float, ...] = (1.0, 0.25)
    # [numerics] Number of halvings of a magnitude that cannot be simulated.
    secant_halvings: int = 2
    # [numerics] Columns only serve to select effects to be fitted. Relative error of a tangent, and
    # of the hundreds of tangents at places (columns at 300 places are off by 0.4 to 0.5 % in the
    # median, 2 % at most); last Newton step of a secant in mm (0.3 % at most); load steps of its
    # friction (one finds 1.2 times the result of eight at the larger magnitude, rotated by 1.8
    # degrees, and 1.02 times, rotated by 0.6, at the smaller one).
    tangent_error: float = 1e-4
    place_error: float = 5e-3
    secant_step_mm: float = 0.05
    secant_friction_steps: int = 1


@dataclass(frozen=True, slots=True)
class DetectabilitySettings:
    """Settings of the detectability of an effect."""

    # [principle] Level and power of a two-sided test: 1 %, detecting an effect in 80 % of cases.
    significance: float = 0.01
    power: float = 0.8
    # [by hand] Absorbed share above which only a strong effect is visible.
    hidden_share: float = 0.95
    # [principle] Absorbed share above which no effect is visible: sqrt(0.025), a sixth of its size,
    # is within the error of models.
    sunk_share: float = 0.975


@dataclass(frozen=True, slots=True)
class JointFitSettings:
    """Settings of the selection of effects for joint fits, and of their starting points."""

    # [cost] Number of single effects that are fitted: those that screening ranks highest. In 120
    # bodies, a fifth changed no verdict, and a fourth none either; in the tutorial's scans a lump,
    # the fourth, ties with the first.
    singles: int = 4
    # [by hand] If the best effect gains more than this, in nats, one effect whose response grows
    # faster than its magnitude is fitted too, because constants fitted without it hide most of it.
    # For a body between plates that begin 5 mm in front of the wall, that effect gains 2.9 nats in
    # the screening, and 59 more than any other effect after a fit.
    far_off: float = 10.0
    # [cost] Number of effects that are added, one at a time, to the named ones. In 120 bodies, one
    # more changed no verdict.
    partners: int = 2
    # [cost] An effect that gains less than this, in nats, is not fitted. In 20 opened bodies, none
    # of 18 such refits gained more than 1.4 nats, and most lost evidence; a lump takes 10 to 30 s.
    least_gain: float = 1.0
    # [cost] An effect is not added to a fit if screening expects less than this part of the gain
    # for which it would be named.
    second_share: float = 0.33
    # [numerics] Start of a fit, as a fraction of the value expected from screening. A one-sided
    # parameter, which has a secant, starts at the expected value itself.
    start: float = 0.5
    # [numerics] It starts no closer to zero, where the response is steepest, than the first of
    # these numbers of prior standard deviations, and no further out than the second.
    least_start: float = 0.1
    most_start: float = 1.5
    # [numerics] The minimum for a response that grows faster than its magnitude: an edge of 2.5 mm.
    # From 5 mm, three bodies reach the same optima, one of them in twice the time.
    steep_start: float = 0.5
    # [numerics] Fractions of these starting sizes that are tried, one after another, until one can
    # be simulated: a compliant wall may fold between them.
    start_shares: tuple[float, ...] = (1.0, 0.5)
    # [cost] Number of the best places from which the fit of a localised effect starts.
    place_starts: int = 2
    # [cost] Iterations after which only the best of several starts continues.
    trial_iterations: int = 3
    # [numerics] Minimum distance between starting places in units of the grid spacing, because
    # neighbours lead to the same optimum.
    places_apart: float = 1.5
    # [principle] A place this far behind the best place, in nats, is not tried: twenty to one.
    places_behind: float = 3.0
    # [numerics] Starting size of a two-sided localised effect, in prior standard deviations: the
    # maximum, and the value if the screening expects zero.
    most_place_start: float = 0.67
    least_place_start: float = 0.067
    # [numerics] Largest change in a constant to compensate for an effect, in prior sd.
    most_compensation: float = 2.0


@dataclass(frozen=True, slots=True)
class FieldSettings:
    """Settings of the smooth field for unlisted causes.

    The field is an unknown displacement along the normals; see `noise_components.smooth_covariance`
    (the model discrepancy of M. C. Kennedy and A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425).

    Raises
    ------
    InputError
        If a number is out of range.
    """

    # [prior] Standard deviations and correlation lengths of the displacement, with all pairs
    # equally probable: from the noise of a segmentation to a third of a breast.
    amplitudes_mm: tuple[float, ...] = (0.1, 0.3, 0.8)
    lengths_mm: tuple[float, ...] = (12.0, 20.0, 35.0)
    # [prior] Correlation between two states: a missing cause acts in all states, with slight
    # differences. [sets 11 and 12, hard sets 8 and 9] Across directions, the missing causes of 41
    # bodies are likelier by a median of 30 nats with 0.2 to 0.4 than with 0.8; a moved chest wall
    # favours 0.8.
    state_correlation: StateCorrelation = field(default=StateCorrelation(along=0.8, across=0.3))
    # [numerics] Variance that the low-rank factor may neglect at a point, for a field of unit
    # amplitude: for the largest field, less than a seventh of the variance of a segmentation of
    # 0.25 mm.
    rank_tolerance: float = 0.05

    def __post_init__(self) -> None:
        scales = self.amplitudes_mm + self.lengths_mm
        usable = self.amplitudes_mm and self.lengths_mm and min(scales) > 0
        if not usable:
            raise InputError(f"A smooth field needs amplitudes > 0 and lengths > 0, found {self}.")

    @property
    def middle_amplitude_mm(self) -> float:
        """The median of the amplitudes."""
        return sorted(self.amplitudes_mm)[len(self.amplitudes_mm) // 2]

    @property
    def middle_length_mm(self) -> float:
        """The median of the lengths."""
        return sorted(self.lengths_mm)[len(self.lengths_mm) // 2]


@dataclass(frozen=True, slots=True)
class SelectionSettings:
    """Thresholds of the rule that names causes, in nats; see `verdict.cause_selection`."""

    # [gap-opened2] The first cause is named if it gains more than this. The ten controls gain at
    # most 3.6 nats, except 7.9 with half the true noise stated and 25.8 with a displaced scan; true
    # causes that can be seen gain 14 and more.
    first: float = 10.0
    # [principle] The same where the noise is known, which nothing common to all points widens: ten
    # corneas without an effect, from another solver, gain at most 1.4 nats.
    first_measured: float = 5.0
    # [gap-opened2] A further one if it adds more than this. Wrong ones add up to 28 nats, because
    # the first has another form than the catalogue's; true ones add 99 and more.
    further: float = 30.0
    # [principle] The same where points were measured: their noise is known, and no segmentation
    # differs at all of them alike, so one threshold holds for all causes.
    further_measured: float = 10.0
    # [principle] Causes closer than this to the best cannot be told apart.
    tie: float = 5.0
    # [gap-opened2] A smooth field that gains more than this beside the named causes shows that
    # something else acts.
    left: float = 10.0


@dataclass(frozen=True, slots=True)
class GapSettings:
    """Settings of the gap in mm and its shrinkage."""

    # [principle] Probability of intervals.
    level: float = 0.9
    # [sets 5, 6, 7, hard] The remaining error of 48 blind bodies with the named effects, and of 14
    # nominal models without a missing effect, has a median of this many times the counted floor; 90
    # % are between these multiples of the median.
    floor_factor: float = 1.3
    floor_range: tuple[float, float] = (0.62, 1.7)
    # [gap-opened, gap-opened2] Factor on standard deviations of constants and magnitudes fitted to
    # scans: what another solver does differently is common to all points, unlike noise.
    solver_spread: float = 1.8
    # [gap-opened, gap-opened2] Standard deviation of a magnitude relative to its size, because a
    # real effect has another form than the catalogue's.
    form_sd: float = 0.2
    # [set 4] Relative standard deviation of the error in the noise variance between cases: the mean
    # square of the residuals scatters by 6 % instead of the theoretical 4 %.
    noise_variance_sd: float = 0.045
    # [sets 5, 6, 7, hard] Half of an excess is credited if it is this many of its standard
    # deviations.
    chance_deviations: float = 2.0
    # [null replicates] Gap due to a mesh from a noisy segmentation, in standard deviations of the
    # noise.
    drawn_noises: float = 0.17
    # [numerics] Draws of the bootstrap and of the posterior, and the seed of their random numbers.
    draws: int = 400
    seed: int = 0
    # [numerics] A scan is not assessed by a fit to the others that moves it by more than this many
    # times the nominal model's error there, beyond the range of a linear model. For 12 FEBio
    # bodies, fits move scans by at most 1.1 times that error, but a fit that does not constrain an
    # edge moves them by hundreds.
    unseen_reach: float = 3.0
    # [numerics] A region is significant if its interval stays above this.
    nothing_mm: float = 1e-9
    # [principle] Minimum number of residuals for which a region has its own gap.
    fewest_residuals: int = 8


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """Settings of the plan of an acquisition."""

    # [principle] An effect that moves the body this far meets no resistance: no organ could move as
    # far.
    drift_mm: float = 100.0
    # [prior] Accuracy of the plate distance shown by a device.
    plates_sd_mm: float = 0.5
    # [prior] Accuracy of the logarithm of a measured stiffness.
    stiffness_sd: float = 0.1
    # [prior] Forces of further loads, relative to the lightest and the heaviest planned load.
    lighter: float = 0.5
    heavier: float = 2.0
    # [prior] Largest factor on the closure of plates at a given distance: twice the closure would
    # crush the body.
    farther: float = 1.25
    # [by hand] Cosine above which two directions of compression count as one view: 14 degrees.
    same_view_cosine: float = 0.97


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of a diagnosis and of a plan."""

    mesh: MeshSettings = field(default_factory=MeshSettings)
    points: PointSettings = field(default_factory=PointSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    unmatched: UnmatchedSettings = field(default_factory=UnmatchedSettings)
    pose: PoseSettings = field(default_factory=PoseSettings)
    numerical: NumericalSettings = field(default_factory=NumericalSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    sensitivities: SensitivitySettings = field(default_factory=SensitivitySettings)
    detectability: DetectabilitySettings = field(default_factory=DetectabilitySettings)
    joint_fits: JointFitSettings = field(default_factory=JointFitSettings)
    smooth_field: FieldSettings = field(default_factory=FieldSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    gap: GapSettings = field(default_factory=GapSettings)
    plan: PlanSettings = field(default_factory=PlanSettings)


SETTINGS = Settings()
