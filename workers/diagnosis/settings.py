"""All numbers that a verdict depends on, in one frozen value, and where each comes from.

Sources are named in brackets: [principle] follows from theory or is a convention of statistics;
[prior] is a belief stated before any data; [numerics] is an accuracy or a bound of an algorithm;
[cost] bounds what is computed; [null replicates] was set on bodies that lack nothing, drawn by the
blind solver with other seeds than any sealed set; [set 2] was set after that blind set of
docs/blind.md had been opened, so that it is no test of it; [open cases] was set while looking at
the open cases of FEBio; [by hand] was chosen when that part was built, and no record says on what.

The seal of a blind set holds this value whole; see `service.blind.sealed_settings`. What only
draws a page stands where it is drawn, in `workers.diagnosis.pictures`.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class MeshSettings:
    """Of the body."""

    # [cost] Of the working mesh: a verdict in a minute or two.
    nodes: int = 5000
    # [cost] Nodes of the mesh that says what the working mesh gets wrong, over those of that one:
    # elements smaller by 2.8^(1/3) = 1.4.
    finer_ratio: float = 2.8


@dataclass(frozen=True, slots=True)
class PointSettings:
    """Of the points on the interfaces, at which model and scans are compared."""

    # [cost] Between neighbours; a breast then has some 900 of them in each scan.
    spacing_mm: float = 6.0
    # [cost] With more loaded scans than these, points are sparser: about as many residuals in all.
    scans_at_that_spacing: int = 2
    # [principle] Points this near to the chest wall sit where the image was cut.
    wall_margin_mm: float = 4.0
    # [principle] Tissue on either side of a point in the reference scan, and reach in which an
    # interface must be alone in a deformed scan where the model puts it, in standard deviations of
    # the segmentation: at 5 of them noise alone reaches no other interface.
    clear_noises: float = 5.0
    # [by hand] Of that reach, by which the distance may differ: curvature and blur.
    clear_slack: float = 0.1
    # [numerics] Radii of the discs over which an interface is averaged, in correlation lengths of
    # the segmentation: the first, or the widest on which it is flat. On a disc of one length the
    # noise keeps 0.6 of its slope, on one of two 0.3.
    discs: tuple[float, ...] = (0.7, 1.0, 1.4, 2.0)
    # [numerics] Rings of a disc with its middle: parts of its radius, and the points on each.
    disc: tuple[tuple[float, int], ...] = ((0.5, 6), (1.0, 8))
    # [numerics] Length of the averaged normal above which an interface is flat, and least length
    # that is stretched to one.
    flat: float = 0.93
    least_slope: float = 0.5


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Of what segmentations err by beyond what is stated."""

    # [null replicates, set 2] An interface as a whole may be drawn too large or too small by this,
    # in standard deviations of the segmentation: points were chosen on one noisy scan. On bodies
    # that lack nothing, means over an interface and all scans scatter by 0.08 to 0.15 of them in
    # all.
    common: float = 0.1
    # [null replicates] A part of every scan's noise is smoother than its correlation length says:
    # on scans segmented with a known noise, smooth sums of residuals scatter 1.25 times as much as
    # they should. Its size in standard deviations, its length in correlation lengths.
    smoother: float = 0.25
    smoother_lengths: float = 3.0
    # [prior] The true deviation of a segmentation over the stated one, its logarithm: a factor of
    # 2 either way costs a nat and a half. And how far that of one interface lies from the others'.
    scale_log_sd: float = 0.405
    interface_log_sd: float = 0.2
    # [prior] Correlation lengths over the stated one, and the deviation of their logarithm.
    lengths: tuple[float, ...] = (0.7, 1.0, 1.4)
    length_log_sd: float = 0.34
    # [prior] Numerical error over what is believed; see `NumericalSettings`.
    numerical_scales: tuple[float, ...] = (0.5, 1.0, 2.0)
    numerical_log_sd: float = 0.5
    # [numerics] Change of a scale's logarithm at which its fixed point has settled: some 1200
    # residuals know it to 0.02 or 0.03. How often that is tried, and where scales stay.
    scale_settled: float = 0.005
    scale_iterations: int = 12
    scale_bounds: tuple[float, float] = (0.2, 5.0)
    # [cost] Points of the average this far behind the best one are left out, in nats.
    hopeless_nats: float = 5.0
    # [principle] Amplitude and length of the field that takes what may be a gap while scales are
    # learnt: so large that it is all but free, or noise that it takes up would go missing.
    learning_field: tuple[float, float] = (1.0, 20.0)
    # [cost] A smooth field is weighed under as many of the likeliest points of the average.
    field_states: int = 1
    # [principle] The noise is read again where the best single effect puts the points, if that is
    # as far from where it was read, root mean square, as the noise is high across the interfaces
    # or long along them.
    elsewhere: float = 1.0
    # [prior] Stated or measured noise that differs from what is learnt by this factor is said.
    misstated: float = 1.25


@dataclass(frozen=True, slots=True)
class UnmatchedSettings:
    """Of points that a scan does not show; see `workers.diagnosis.unmatched_points`."""

    # [principle] The displacement is that of something unlisted, larger by this: all but free.
    freer: float = 4.0
    # [principle] Of Huber and of Tukey, in deviations: 95 % efficient where noise is normal.
    huber: float = 1.345
    biweight: float = 4.685
    # [numerics] Change of a deviation at which the fit has settled, and how often it is repeated.
    settled: float = 0.01
    iterations: int = 12
    # [principle] Noise is no smaller than this part of what is stated: half of it is possible.
    least_scale: float = 0.5
    # [principle] In robust deviations of an interface: a point as far as the first has no
    # counterpart, nor have points beside it that are as far as the second. Of a thousand points,
    # six deviations of normal noise are reached once in a million bodies.
    far: float = 6.0
    beside: float = 3.0
    # [by hand] What is beside a point, as a part of the middle length of something unlisted: 8 mm
    # in a breast.
    beside_lengths: float = 0.4
    # [by hand] A connected piece of so few points follows any fit, so all others judge it.
    small_piece: int = 12
    # [by hand] Where more points than this part of all are far off, that is no error of drawing.
    most: float = 0.1


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """Of where each scan lies [prior]: what a registration leaves."""

    shift_sd_mm: float = 0.3
    turn_sd_deg: float = 0.3
    # Parts of these deviations, equally probable, that scans of one case have in truth: some lie
    # where their headers say, and then what shifts a body as a pose does can be seen. Less than a
    # tenth of a millimetre would be less than voxels and numerical errors leave.
    scales: tuple[float, ...] = (0.3, 1.0)
    # In standard deviations of the segmentation: an interface drawn too large in one scan, by a
    # habit or by half a voxel.
    drawing: float = 0.3
    # [numerics] A scan is moved to where its residuals say that it lies until that changes by less
    # than this, in the standard deviations above: 0.003 mm. How often at most; and what part of
    # the step before a step is at most that is not halved.
    settled: float = 0.01
    registrations: int = 12
    shorter: float = 0.7


@dataclass(frozen=True, slots=True)
class NumericalSettings:
    """Of what another mesh, element and contact of the same physics would change."""

    # [open cases] A part that every solver has, in mm; and as much of the nugget for voxels larger
    # than theirs: where a face lies along voxels, what they cannot show is the same all over it.
    least_mm: float = 0.03
    of_nugget: float = 0.75
    # [numerics] A part of what a finer mesh changes, root mean square of each scan: what is
    # still unknown after that difference is taken off is as large as the difference itself.
    of_difference: float = 1.0
    # [open cases] A part of how far the load moves a point.
    of_motion: float = 0.0
    # [by hand] It is smooth over this length, and the same, but for its size, in all scans; of
    # markers, whose states load the body in different ways, less so.
    length_mm: float = 16.0
    state_correlation: float = 1.0
    state_correlation_markers: float = 0.8
    # [numerics] Part of its variance that a low rank may miss.
    rank_tolerance: float = 0.1


@dataclass(frozen=True, slots=True)
class FormSettings:
    """Of how far a real effect's pattern differs from that of the catalogue [prior].

    The pattern is what the effect changes of the residuals once constants and poses have followed.
    The error is a smooth part of it. Lengths are those of the smooth field that stands for
    something else, as its organ has it, times these.
    """

    relative_sd: float = 0.2
    lengths: float = 1.5
    # [open cases] Of effects that do not act but resemble a cause that is not listed, and how
    # probable that is before data.
    likeness_sd: float = 0.5
    likeness: float = 0.03
    # Over which the size of a pattern is averaged: an error need not vanish where it changes sign.
    envelope_lengths: float = 0.6
    state_correlation: float = 0.9
    rank_tolerance: float = 2e-2


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Of Gauss and Newton's method."""

    # [numerics] Most fits take 3 to 6; along the valley of a law with two alike terms it was 23.
    max_iterations: int = 30
    # [numerics] The last trial of a line search is 0.4^7 = 0.002 of the step.
    max_halvings: int = 8
    shortening: float = 0.4
    # [principle] A fall of minus twice the log posterior below this changes no verdict: 0.025 nats.
    tolerance: float = 0.05
    # [principle] Where no step of the line search falls, the fit has converged if less than this
    # fall was expected: half a nat.
    at_rest: float = 1.0
    # [numerics] Longest step of a parameter in prior standard deviations.
    longest_step: float = 1.5
    # [numerics] Difference of the logarithm of a constant for its derivative.
    log_step: float = 1e-4
    # [by hand] Difference of friction in prior standard deviations. Friction sets in with full
    # force and then tires: its tangent at zero is several times too steep.
    friction_step: float = 0.2
    # [cost] Within this, in the same unit, the derivative by friction is taken over.
    friction_near: float = 0.15


@dataclass(frozen=True, slots=True)
class SensitivitySettings:
    """Of what every effect would do to the residuals of the nominal fit."""

    # [cost] Between centres at which a lump is looked for: a lump of 10 mm radius is met.
    inclusion_grid_mm: float = 12.0
    # [principle] How deep inside the body they lie at least: half a lump.
    inclusion_depth_mm: float = 6.0
    # [by hand] Magnitudes at which a one-sided effect is tried, in prior standard deviations:
    # one that is plausible, and one near zero, where such effects are steepest.
    secant_magnitudes: tuple[float, ...] = (1.0, 0.25)
    # [numerics] How often a magnitude that cannot be simulated is halved.
    secant_halvings: int = 2
    # [numerics] Columns only choose what is fitted: relative error of a tangent, Newton's last
    # step of a secant in mm, steps of its friction (0.5 to 2 % off those of eight).
    tangent_error: float = 1e-4
    secant_step_mm: float = 0.02
    secant_friction_steps: int = 4


@dataclass(frozen=True, slots=True)
class DetectabilitySettings:
    """Of what the data could show of an effect."""

    # [principle] A two-sided test at 1 % that finds an effect in 80 % of cases.
    significance: float = 0.01
    power: float = 0.8
    # [by hand] Absorbed share above which little of an effect is left to see: only of a
    # strong one.
    hidden_share: float = 0.95
    # [principle] Absorbed share above which nothing is: sqrt(0.025), a sixth of its size, no more
    # than models err.
    sunk_share: float = 0.975


@dataclass(frozen=True, slots=True)
class JointFitSettings:
    """Of which effects are fitted together with the constants, and from where."""

    # [cost] Single effects that are fitted: the best by screening.
    singles: int = 5
    # [cost] The best of them are paired with each other.
    partners: int = 3
    # [by hand] An effect this far behind the best one by screening is not fitted, in nats; nor
    # fitted again once the noise was read again.
    far_behind: float = 60.0
    # [by hand] But one that gains this part of what the best one gains is: where data are much
    # finer than the effects, the linear model errs by more than that.
    nearly: float = 0.5
    # [principle] Nor is one that the data speak against, in nats.
    least_gain: float = 0.0
    # [by hand] Pairs are fitted if a smooth field gains this much on top of the best effect.
    left_over: float = 1.0
    # [principle] So is one with an effect that gains this much on top of it, as it looked alone:
    # twenty to one. A third effect is fitted beside the best pair by the same rule.
    second_gain: float = 3.0
    # [cost] Third effects that are fitted.
    thirds: int = 2
    # [numerics] Where a fit begins, as a part of what the screening expects. A one-sided
    # parameter, whose secant was taken, begins where that expects it.
    start: float = 0.5
    # [numerics] But not nearer to zero than this part of its prior standard deviation, where it is
    # steepest, and no further out than that many of them.
    least_start: float = 0.1
    most_start: float = 1.5
    # [cost] Best places from which the fit of a lump begins.
    inclusion_starts: int = 2
    # [numerics] Logarithm of a lump's ratio of stiffness at which its fit begins: at most, and
    # where the screening expects none.
    most_start_log_ratio: float = 1.0
    least_start_log_ratio: float = 0.1
    # [numerics] Longest change of a constant that makes room for an effect, in prior sd.
    most_compensation: float = 2.0


@dataclass(frozen=True, slots=True)
class FieldSettings:
    """Of the smooth field that stands for something else."""

    # [prior] Standard deviations and correlation lengths of the displacement, all pairs equally
    # probable: from the noise of a segmentation to a third of a breast.
    amplitudes_mm: tuple[float, ...] = (0.1, 0.3, 0.8)
    lengths_mm: tuple[float, ...] = (12.0, 20.0, 35.0)
    # [prior] Between two states: a missing cause acts in all of them, but not quite alike.
    state_correlation: float = 0.8
    # [numerics] Variance that the low rank may miss at a point, of a field of unit amplitude: less
    # than a seventh of that of a segmentation of 0.25 mm, for the largest field.
    rank_tolerance: float = 0.05


@dataclass(frozen=True, slots=True)
class OddsSettings:
    """How probable each kind of hypothesis is before data; they sum to 1 [prior]."""

    nothing: float = 0.30
    field: float = 0.15
    single: float = 0.38
    single_and_field: float = 0.02
    pair: float = 0.11
    pair_and_field: float = 0.01
    triple: float = 0.025
    triple_and_field: float = 0.005
    # Where something unlisted acts beside effects: that these act indeed, and do not only
    # resemble a part of it. If they do, the part of the evidence that is left to the unlisted is
    # small, exponential with this mean; a mere likeness leaves any part alike.
    beside_unlisted: float = 0.5
    unlisted_part: float = 0.1


@dataclass(frozen=True, slots=True)
class VerdictSettings:
    """Of how probabilities become a verdict."""

    # [principle] Probability that the credible set holds, and above which a second effect of the
    # best pair is named.
    credible: float = 0.9


@dataclass(frozen=True, slots=True)
class GapSettings:
    """Of the gap in mm and its shrinkage."""

    # [principle] Of intervals.
    level: float = 0.9
    # [set 1 to 3] The floor is not known exactly: what the right model missed of 98 blind
    # bodies lies between these parts of it in nine out of ten.
    floor_range: tuple[float, float] = (0.75, 1.5)
    # [null replicates] Gap that a mesh from a noisy segmentation opens, in standard deviations of
    # the noise.
    drawn_noises: float = 0.17
    # [numerics] Draws of the bootstrap, and the seed of their random numbers.
    draws: int = 400
    seed: int = 0
    # [numerics] A region is significant if its interval does not reach down to this.
    nothing_mm: float = 1e-9
    # [principle] A region needs as many residuals for a gap of its own.
    fewest_residuals: int = 8


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """Of what an acquisition can tell before it is made."""

    # [principle] Log evidence that decides: twenty to one.
    clear: float = 3.0
    # [principle] An effect that moves the body so far meets no resistance: no organ could.
    drift_mm: float = 100.0
    # [prior] How well a device tells the distance of its plates.
    plates_sd_mm: float = 0.5
    # [prior] How well a stiffness is known once it is measured: of its logarithm.
    stiffness_sd: float = 0.1
    # [prior] Forces of further loads, over the lightest and the heaviest planned one.
    lighter: float = 0.5
    heavier: float = 2.0
    # [prior] Plates at a distance are moved by a share of the closing: twice of it would crush
    # the body.
    farther: float = 1.25
    # [by hand] Cosine of two directions of compression that are one view: 14 degrees.
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
    form: FormSettings = field(default_factory=FormSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    sensitivities: SensitivitySettings = field(default_factory=SensitivitySettings)
    detectability: DetectabilitySettings = field(default_factory=DetectabilitySettings)
    joint_fits: JointFitSettings = field(default_factory=JointFitSettings)
    smooth_field: FieldSettings = field(default_factory=FieldSettings)
    prior_odds: OddsSettings = field(default_factory=OddsSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)
    gap: GapSettings = field(default_factory=GapSettings)
    plan: PlanSettings = field(default_factory=PlanSettings)


SETTINGS = Settings()
