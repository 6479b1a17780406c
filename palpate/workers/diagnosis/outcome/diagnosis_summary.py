"""Schema of a diagnosis in plain numbers, as printed by `palpate diagnose --json`.

Frozen dataclasses, used by the report, the commands and the blind scores; `json_digests`
writes and reads them. Lengths are in mm, constants in kPa; parameters of effects are stored with
their units. The first ones belong to bench experiments alone: points, forces, predicted states.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from palpate.storage.read_only import ReadOnly
from palpate.storage.values import Triple
from palpate.workers.diagnosis.verdict.cause_selection import Kind
from palpate.workers.mechanics.model_parameters import ShownMagnitude

CheckedOn = Literal["same scan", "other scans"]


@dataclass(frozen=True, slots=True)
class MarkerResidual:
    """Displacement of a point on a specimen, along x, y and z of the body.

    `before_mm` and `after_mm` are the residuals of the models.
    """

    name: str
    displacement_mm: Triple
    before_mm: Triple
    after_mm: Triple | None


@dataclass(frozen=True, slots=True)
class Reaction:
    """The force on a region along an axis, with its standard deviation."""

    region: str
    axis: str
    force_n: float
    sd_n: float

    @property
    def place(self) -> str:
        """The region and direction of the force, in words."""
        return f"{self.region} along {self.axis}"


@dataclass(frozen=True, slots=True)
class ReactionResidual(Reaction):
    """A measured force with the residuals of the models."""

    before_n: float
    after_n: float | None


@dataclass(frozen=True, slots=True)
class MarkerState:
    """All points of one state; `repeats_mm` is the distance between two recordings, if any."""

    state: str
    repeats_mm: float | None
    points: tuple[MarkerResidual, ...]
    reactions: tuple[ReactionResidual, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points measured>"


@dataclass(frozen=True, slots=True)
class ConfoundedEffect(ReadOnly):
    """Constants in kPa fitted ``without`` and ``with`` a hidden effect of the given size."""

    name: str
    size: Mapping[str, float]
    constants_kpa: Mapping[str, Mapping[str, float]]

    def __repr__(self) -> str:
        return f"<Confounded effect {self.name}: {', '.join(self.constants_kpa)}"[:498] + ">"


@dataclass(frozen=True, slots=True)
class PredictedPoint:
    """Predicted displacement of a point along x, y and z of the body, with standard deviations.

    `measured_mm` is the displacement in the recordings of a held-out state; None without them.
    """

    name: str
    displacement_mm: Triple
    sd_mm: Triple
    measured_mm: Triple | None = None


@dataclass(frozen=True, slots=True)
class Agreement:
    """How a prediction agrees with the recordings of a held-out state.

    Parameters
    ----------
    components : int
        Number of compared components.
    within : int
        Number of those within two standard deviations.
    rms_mm : float
        Root mean square difference.
    """

    components: int
    within: int
    rms_mm: float


@dataclass(frozen=True, slots=True)
class PredictedState:
    """All points of an unmeasured state, and the forces on it."""

    state: str
    points: tuple[PredictedPoint, ...]
    reactions: tuple[Reaction, ...] = ()

    def __repr__(self) -> str:
        return f"<State {self.state}: {len(self.points)} points predicted>"

    @property
    def agreement(self) -> Agreement | None:
        """Agreement with the recordings of a held-out state; None if nothing is compared."""
        off = [
            (value - seen, sd)
            for point in self.points
            for value, sd, seen in zip(
                point.displacement_mm, point.sd_mm, point.measured_mm or (), strict=False
            )
            if math.isfinite(value - seen)
        ]
        if not off:
            return None
        within = sum(abs(difference) <= 2 * sd for difference, sd in off)
        square = sum(difference**2 for difference, _ in off) / len(off)
        return Agreement(len(off), within, math.sqrt(square))


@dataclass(frozen=True, slots=True)
class GapEstimate:
    """Root mean square distance between model and scan, less the noise, with its interval.

    `noise_mm` is the observation noise at one point, `points` the number of residuals.
    """

    gap_mm: float
    low_mm: float
    high_mm: float
    noise_mm: float
    points: int


@dataclass(frozen=True, slots=True)
class ShareEstimate:
    """Share of the squared gap that effects remove, with its interval; nan without a gap."""

    share: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class GapShrinkage:
    """The gap without and with the named effects."""

    before: GapEstimate
    after: GapEstimate
    share: ShareEstimate


@dataclass(frozen=True, slots=True)
class GapSummary(ReadOnly):
    """The gap over all scans, in-sample and with each scan held out.

    Parameters
    ----------
    before : GapEstimate
        Gap of the nominal model.
    noise_floor : float
        Observation noise at one point, in mm.
    calibration_floor : float
        Error that even the true model has, in mm.
    after : GapEstimate or None
        Gap with the named effects; this and the following are None if there are none.
    held_out_before, held_out_after : GapEstimate or None
        Also None for a single scan.
    share, held_out_share : ShareEstimate, optional
    held_out : str, optional
        How scans were held out, in words.
    held_out_each : mapping of str to GapShrinkage, optional
        Held-out gap by name of the scan.
    chosen_again : tuple of str, optional
        Held-out scans whose other scans name the same effects; for the rest, the held-out gap is
        that of the nominal model. None for fewer than three scans, where all scans chose.
    not_judged : tuple of str
        Scans that cannot be assessed by a fit to the others, because these do not constrain them.
    fitted_mm, undeformed_mm : float, optional
        Root mean square distances from the scans to the best fit and to the body at rest, including
        noise. None in records of earlier versions.
    """

    before: GapEstimate
    noise_floor: float
    calibration_floor: float
    after: GapEstimate | None
    held_out_before: GapEstimate | None
    held_out_after: GapEstimate | None
    share: ShareEstimate | None = None
    held_out_share: ShareEstimate | None = None
    held_out: str | None = None
    held_out_each: Mapping[str, GapShrinkage] | None = None
    chosen_again: tuple[str, ...] | None = None
    not_judged: tuple[str, ...] = ()
    fitted_mm: float | None = None
    undeformed_mm: float | None = None

    def __repr__(self) -> str:
        after = "" if self.after is None else f", {self.after.gap_mm:.3g} mm with the cause"
        return f"<Gap of {self.before.gap_mm:.3g} mm{after}>"

    @property
    def fits_no_better_than_rest(self) -> bool:
        """Whether the body at rest explains the scans as well as the best fit does."""
        if self.fitted_mm is None or self.undeformed_mm is None:
            return False
        return self.fitted_mm >= self.undeformed_mm

    @property
    def checked_on(self) -> CheckedOn | None:
        """Return the scans on which the named effects were checked; None if there are none.

        On the scans that they were fitted to, effects reduce a gap even if they are not its cause.
        """
        if self.after is None:
            return None
        return "same scan" if self.held_out_after is None else "other scans"


@dataclass(frozen=True, slots=True)
class InterfaceNoise:
    """Segmentation noise of an interface, as given and as learnt: standard deviations in mm."""

    interface: str
    stated_mm: float
    learnt_mm: float


@dataclass(frozen=True, slots=True)
class RegionGap:
    """The gap of the nominal model in a part of an interface in one scan.

    `signed_mean_mm` is positive if the model is outside the scan; `p50_mm` and `p95_mm` are
    quantiles of the absolute distance.
    """

    scan: str
    interface: str
    region: str
    gap_mm: float
    low_mm: float
    high_mm: float
    noise_mm: float
    points: int
    signed_mean_mm: float
    significant: bool
    p50_mm: float | None = None
    p95_mm: float | None = None


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """Estimate of an effect's parameter, with its standard deviation, in its unit.

    `shown` is the estimate as displayed; None in records of earlier versions.
    """

    parameter: str
    magnitude: float
    sd: float
    unit: str
    shown: ShownMagnitude | None = None


@dataclass(frozen=True, slots=True)
class EffectSummary:
    """Gain and estimated parameters of one effect.

    Parameters
    ----------
    name, family, summary : str
    gain : float or None
        Gain in log evidence from fitting this effect alone, in nats; None if it was not fitted.
    magnitude, sd, unit
        Estimate of the most significant parameter.
    parameters : tuple of ParameterEstimate
    log_bayes_factor : float
        Log Bayes factor from the screening, in nats.
    absorbed_share : float
        Share of the effect that the constants absorb, 0 to 1.
    refitted : bool
        Whether the effect was fitted together with the constants.
    shown : ShownMagnitude, optional
        The magnitude as displayed; see `workers.mechanics.model_parameters`.
    seen_from : float, optional
        Size in `seen_unit` from which these data would have shown the effect; None if the constants
        hide it at any size.
    seen_unit : str
    """

    name: str
    family: str
    summary: str
    gain: float | None
    magnitude: float
    sd: float
    unit: str
    parameters: tuple[ParameterEstimate, ...]
    log_bayes_factor: float
    absorbed_share: float
    refitted: bool
    shown: ShownMagnitude | None = None
    seen_from: float | None = None
    seen_unit: str = ""

    def __repr__(self) -> str:
        gain = "not fitted" if self.gain is None else f"{self.gain:+.3g} nats"
        return f"<Effect {self.name}: {gain}>"


@dataclass(frozen=True, slots=True)
class ConstantEstimate:
    """Estimates of a constant in kPa, without and with the named effects, if any.

    Parameters
    ----------
    before, after : float
    before_interval, after_interval : (float, float), optional
        90 % intervals of both estimates; None in records of earlier versions.
    stated : (float, float), optional
        The interval given in the case.
    converged : bool, optional
        Whether the underlying fit converged.
    depends_on_law : bool, optional
        Whether a named effect describes the material law, so that the constant, a slope at small
        strain, depends on the form of that effect.
    """

    before: float
    after: float | None
    before_interval: tuple[float, float] | None = None
    after_interval: tuple[float, float] | None = None
    stated: tuple[float, float] | None = None
    converged: bool | None = None
    depends_on_law: bool | None = None


@dataclass(frozen=True, slots=True)
class JointFitSummary(ReadOnly):
    """Gain in log evidence of a joint fit of effects over the nominal model, in nats.

    `field_gain` is the further gain from a smooth field, for the named effects; `values` holds all
    parameters at the optimum, in internal names and units.
    """

    effects: tuple[str, ...]
    log_evidence_gain: float
    field_gain: float | None
    converged: bool
    values: Mapping[str, float]

    def __repr__(self) -> str:
        effects = ", ".join(self.effects) or "no effect"
        return f"<Joint fit of {effects}: {self.log_evidence_gain:+.3g} nats"[:498] + ">"


@dataclass(frozen=True, slots=True)
class OverlapFigures:
    """Overlap of a predicted and an observed body; see `Score` and `Distances`."""

    jc: float
    dice: float
    mhd_mm: float
    mhd_voxels: float
    gsf: float
    p50_mm: float
    p95_mm: float
    signed_mean_mm: float
    points: int


@dataclass(frozen=True, slots=True)
class OverlapRow:
    """Overlap inside one interface in one scan, and the Jaccard coefficient reachable in noise."""

    scan: str
    interface: str
    reachable_jc: float
    before: OverlapFigures
    after: OverlapFigures | None


@dataclass(frozen=True, slots=True)
class LoudestPlace:
    """The place where a lump would best explain the residuals; see `outcome.residual_maps`."""

    score: float
    x_mm: float
    y_mm: float
    z_mm: float
    ln_ratio: float
    ln_ratio_sd: float
    reached_by_noise: float
    places: int
    places_seen: int


@dataclass(frozen=True, slots=True)
class CauseMapSummary:
    """Most significant places in the maps of causes, before and after adding the named effects."""

    before: LoudestPlace
    after: LoudestPlace | None = None


@dataclass(frozen=True, slots=True)
class NextAcquisition:
    """A further measurement, the pairs of suspects that it separates, and the effects it reveals.

    `minimum_ratio` is the factor by which minimum detectable magnitudes change.
    """

    name: str
    separates: tuple[tuple[str, ...], ...]
    reveals: tuple[str, ...]
    minimum_ratio: float

    def __repr__(self) -> str:
        told_apart = f"separates {len(self.separates)} pairs"
        return f"<Measurement {self.name}: {told_apart}, reveals {len(self.reveals)} effects>"


@dataclass(frozen=True, slots=True)
class Summary(ReadOnly):
    """A diagnosis in plain numbers.

    Parameters
    ----------
    case : str
    verdict : {"no-gap", "effect", "cannot-be-told-apart", "none-of-these"}
    primary : tuple of str
        The named effects; see `workers.diagnosis.verdict.cause_selection.Verdict`.
    effects : tuple of EffectSummary
        All effects that act and could be simulated, in the order of the catalogue.
    rivals : tuple of str
        Effects that cannot be told apart from the first, the best first.
    absorbed : tuple of str
        Effects that the constants hide.
    gain : float
        Gain of the best single effect in log evidence, in nats.
    left_gain : float
        Gain of a smooth field in addition to the named effects, in nats.
    something_else : bool
        Whether that gain shows that something else acts.
    gap_mm : GapSummary
    where : tuple of RegionGap
    constants : mapping of str to ConstantEstimate
        Estimates by external name, such as ``E_fat_kpa``.
    refits : tuple of JointFitSummary
    points, left_out : int
        Numbers of points on the interfaces that were used, and left out as unclear in some scan.
    overlap, cause_map : optional
        Only for a scanned body.
    markers, hidden, predictions : optional
        Only for a bench experiment.
    next_acquisitions : optional
        Only if further measurements were planned.
    noise : tuple of InterfaceNoise, optional
        Segmentation noise, if it was learnt.
    surfaces, compared : tuple of str, str
        The interfaces, and the location of their points in words.
    not_simulated : optional
        Causes without an effect in the catalogue, and the reasons; if None, the causes for a
        breast.
    caveats : tuple of str, optional
        Caveats shown first, such as a failed plausibility check.
    doubts : tuple of str, optional
        Sentences shown before the verdict: reasons not to rely on it.
    data_notes : tuple of str, optional
        Sentences about missing data that were not compared.
    """

    case: str
    verdict: Kind
    primary: tuple[str, ...]
    effects: tuple[EffectSummary, ...]
    rivals: tuple[str, ...]
    absorbed: tuple[str, ...]
    gain: float
    left_gain: float
    something_else: bool
    gap_mm: GapSummary
    where: tuple[RegionGap, ...]
    constants: Mapping[str, ConstantEstimate]
    refits: tuple[JointFitSummary, ...]
    points: int
    overlap: tuple[OverlapRow, ...] | None = None
    cause_map: CauseMapSummary | None = None
    markers: tuple[MarkerState, ...] | None = None
    hidden: tuple[ConfoundedEffect, ...] | None = None
    predictions: tuple[PredictedState, ...] | None = None
    next_acquisitions: tuple[NextAcquisition, ...] | None = None
    noise: tuple[InterfaceNoise, ...] | None = None
    surfaces: tuple[str, ...] = ("outline", "glandular")
    compared: str = "the outline and on the boundary of the glandular tissue"
    not_simulated: tuple[tuple[str, str], ...] | None = None
    left_out: int = 0
    caveats: tuple[str, ...] | None = None
    doubts: tuple[str, ...] = ()
    data_notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        cause = f" ({', '.join(self.primary)})" if self.primary else ""
        text = f"<Summary of {self.case}: {self.verdict}{cause}, {self.gap_mm!r}"
        return f"{text}, {len(self.effects)} effects, {self.points} points"[:498] + ">"

    def effect(self, name: str) -> EffectSummary:
        """Return the summary of one effect.

        Raises
        ------
        KeyError
            If the effect does not act or could not be simulated.
        """
        found = {one.name: one for one in self.effects}
        return found[name]
