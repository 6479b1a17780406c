"""Settings of errors other than missing effects: segmentation, poses, numerics and form.

Sources are named in brackets as in `workers.diagnosis.settings.values`, which includes these.
"""

from dataclasses import dataclass, field

from palpate.workers.diagnosis.settings.state_correlation import StateCorrelation


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Settings of segmentation errors in addition to the given noise."""

    # [gap-opened2] Power of the evidence; see `workers.diagnosis.noise.evidence`. On 37 bodies
    # solved by FEBio, false second causes gain 3 to 11 nats, false alarms 6 to 19, and true second
    # causes 49 to 176.
    coarsening: float = 0.3

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
    # [sets 10 and 11, hard sets 7 and 8] Mean and scatter of the skin stiffness, in N/mm, that
    # screening finds on bodies without a skin, if the scan at rest has the segmentation error
    # below: on ten bodies without a missing effect 0 to 107 N/m, 42 on average, with two directions
    # of compression, and 45 to 123 with one. See `workers.diagnosis.screening.rough_surface`.
    rough_skin_n_per_mm: float = 0.045
    rough_skin_sd_n_per_mm: float = 0.035
    rough_at_mm: float = 0.28
    # [numerics] Neglected variance of the common error of flat faces, in mm^2; see
    # `workers.diagnosis.problem.voxel_steps`.
    voxel_variance_mm2: float = 0.002
    # [prior] Standard deviation of the log ratio of true to given segmentation noise, where a
    # factor of 2 in either direction costs one and a half nats; and the scatter of single
    # interfaces around it.
    scale_log_sd: float = 0.405
    interface_log_sd: float = 0.2
    # [prior] ln of the ratio of the noise at either end of the body to the noise in the middle,
    # along each axis: a factor of 1.5 from end to end is one standard deviation.
    uneven_sd: float = 0.2
    # [prior] Correlation lengths relative to the given length, and the standard deviation of their
    # logarithm.
    lengths: tuple[float, ...] = (0.7, 1.0, 1.4)
    length_log_sd: float = 0.34
    # [prior] Numerical error relative to its assumed size; see `NumericalSettings`.
    numerical_scales: tuple[float, ...] = (0.5, 1.0, 2.0)
    numerical_log_sd: float = 0.5
    # [numerics] Change of a scale's logarithm at which its fixed point has converged (some 1200
    # residuals determine it to within 0.02 or 0.03); maximum number of iterations; bounds of the
    # scales.
    scale_settled: float = 0.005
    scale_iterations: int = 12
    scale_bounds: tuple[float, float] = (0.2, 5.0)
    # [cost] Noise states this far behind the best state, in nats, are omitted.
    hopeless_nats: float = 5.0
    # [principle] Amplitude and length of the field that absorbs a possible gap while scales are
    # learnt: so large that the field is almost free, as otherwise the noise that it absorbs would
    # be missed.
    learning_field: tuple[float, float] = (1.0, 20.0)
    # [cost] Number of the likeliest noise states for which a smooth field is evaluated.
    field_states: int = 1
    # [principle] The noise is estimated again at the points of the best single effect if their root
    # mean square shift reaches this multiple of the standard deviation of the noise across the
    # interfaces, or of its correlation length along them.
    elsewhere: float = 1.0
    # [prior] Given or measured noise that differs from the learnt noise by this factor is reported.
    misstated: float = 1.25
    # [prior] Noise this many times larger in one part of the body than in another is also reported.
    uneven_ratio: float = 1.5


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
    # Equally probable ratios of a case's true deviations to these: the headers of some scans are
    # accurate, and effects that shift a body as a pose does are then visible. Less than a tenth of
    # a millimetre would be below voxel and numerical errors.
    scales: tuple[float, ...] = (0.3, 1.0)
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
class FormSettings:
    """Settings of the difference between a real effect's pattern and the catalogue's [prior].

    The pattern is the change in the residuals due to the effect, after refitting constants and
    poses. The error is the local size of the pattern times a smooth field. Lengths are multiples of
    the organ's length for the smooth field.
    """

    # [set 8, hard set 5] Standard deviation of the error relative to the pattern: a fifth, within a
    # factor of two.
    relative_sds: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    typical_sd: float = 0.2
    log_sd: float = 0.7
    # [set 8, hard set 5] Relative standard deviation for effects that do not act but resemble an
    # unlisted cause; [open cases] prior probability of such a case.
    likeness_sd: float = 0.8
    likeness: float = 0.03
    lengths: float = 1.5
    # Length for averaging the size of a pattern, so that the error does not vanish where the
    # pattern changes sign.
    envelope_lengths: float = 0.6
    state_correlation: StateCorrelation = field(default=StateCorrelation(along=0.9, across=0.3))
    rank_tolerance: float = 2e-2
