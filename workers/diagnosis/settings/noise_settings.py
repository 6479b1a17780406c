"""Settings of all that is neither the model nor an effect: drawing, poses, numerics, form.

Sources are named in brackets as in `workers.diagnosis.settings.values`, of which these are a part.
"""

from dataclasses import dataclass, field

from palpate.workers.diagnosis.settings.state_correlation import StateCorrelation


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Settings of what segmentations err by beyond what is stated."""

    # [null replicates, set 2] An interface as a whole may be drawn too large or too small by this,
    # in standard deviations of the segmentation: points were chosen on one noisy scan. On bodies
    # that lack nothing, means over an interface and all scans scatter by 0.08 to 0.15 of them in
    # all.
    common: float = 0.1
    # [null replicates] A part of every scan's noise, of the one at rest too, is smoother than its
    # correlation length says: its size in standard deviations, its length in correlation lengths.
    # On 30 bodies of the hard world that lack nothing what scans err by, apart from what the model
    # does, is likelier by 27 nats in all than with 0.25 and 3 and none of it at rest, where noise
    # of 0.3 mm and more has it; 0.3 to 0.35 and 2 to 2.5 are as good.
    smoother: float = 0.30
    smoother_lengths: float = 2.5
    # [sets 10 and 11, hard sets 7 and 8] Skin, in N/mm, that the screening finds on bodies without
    # one, and how it scatters, where the scan at rest was drawn with so much error: on ten that
    # lack nothing 0 to 107 N/m, 42 in the mean, along two directions, and 45 to 123 along one. See
    # `workers.diagnosis.screening.rough_surface`.
    rough_skin_n_per_mm: float = 0.045
    rough_skin_sd_n_per_mm: float = 0.035
    rough_at_mm: float = 0.28
    # [numerics] Variance that may be missing of what voxels hide of flat faces, in mm^2; see
    # `workers.diagnosis.problem.voxel_steps`.
    voxel_variance_mm2: float = 0.002
    # [prior] The true deviation of a segmentation over the stated one, its logarithm: a factor of
    # 2 either way costs a nat and a half. And how far that of one interface lies from the others'.
    scale_log_sd: float = 0.405
    interface_log_sd: float = 0.2
    # [prior] ln of how much larger the deviation is at either end of the body than in its middle,
    # along each axis: a factor of 1.5 from end to end is one standard deviation.
    uneven_sd: float = 0.2
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
    # [prior] So is noise that is this many times larger in one part of the body than in another.
    uneven_ratio: float = 1.5


@dataclass(frozen=True, slots=True)
class UnmatchedSettings:
    """Settings of points that a scan does not show; see `diagnosis.noise.unmatched_points`."""

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
    # counterpart, nor have points beside it that are as far as the second. Nor have points as far
    # as the second that are, in all scans together, as improbable as the first. Of a thousand
    # points, six deviations of normal noise are reached once in a million bodies.
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
    """Settings of where each scan lies [prior]: what a registration leaves."""

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
    """Settings of what another mesh, element and contact of the same physics would change."""

    # [open cases] A part that every solver has, in mm; and as much of the nugget for voxels larger
    # than theirs: where a face lies along voxels, what they cannot show is the same all over it.
    least_mm: float = 0.03
    of_nugget: float = 0.75
    # [numerics] A part of what a finer mesh changes, root mean square of each scan: what is
    # still unknown after that difference is taken off is as large as the difference itself.
    of_difference: float = 1.0
    # [sets 10 to 12, hard sets 7 to 9] It is smooth over this length, the same along one direction
    # and another one across: what is left of the nominal model's true error on 16 bodies that lack
    # nothing, once constants and poses are taken off, is likeliest with 10 to 12 mm, 0.94 and -0.2.
    # A little more than nothing across: what voxels leave of the scan at rest is in all scans.
    # [by hand] Of markers, whose states load the body in different ways, less alike.
    length_mm: float = 12.0
    state_correlation: StateCorrelation = field(default=StateCorrelation(along=0.94, across=0.1))
    state_correlation_markers: StateCorrelation = field(
        default=StateCorrelation(along=0.8, across=0.0)
    )
    # [numerics] Part of its variance that a low rank may miss.
    rank_tolerance: float = 0.3


@dataclass(frozen=True, slots=True)
class FormSettings:
    """Settings of how far a real effect's pattern differs from that of the catalogue [prior].

    The pattern is what the effect changes of the residuals once constants and poses have followed.
    The error is a smooth part of it. Lengths are those of the smooth field that stands for
    something else, as its organ has it, times these.
    """

    # [set 8, hard set 5] Deviation of the error over the size of the pattern: a fifth, give or
    # take a factor of two.
    relative_sds: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    typical_sd: float = 0.2
    log_sd: float = 0.7
    # [set 8, hard set 5] Of effects that do not act but resemble a cause that is not listed;
    # [open cases] how probable that is before data.
    likeness_sd: float = 0.8
    likeness: float = 0.03
    lengths: float = 1.5
    # Over which the size of a pattern is averaged: an error need not vanish where it changes sign.
    envelope_lengths: float = 0.6
    state_correlation: StateCorrelation = field(default=StateCorrelation(along=0.9, across=0.3))
    rank_tolerance: float = 2e-2
