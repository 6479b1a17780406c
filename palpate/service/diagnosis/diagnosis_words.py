"""Verdicts and plans in words, for readers who know the images but not the statistics.

The verdict of a diagnosis comes first, then a plan for the person who takes the scans, then the
ranking of further measurements by how much they add to a diagnosis.
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Literal, Protocol

from palpate.service.number_formatting import MINUS, NONE, listed, number
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    EffectSummary,
    GapEstimate,
    GapSummary,
    MarkerState,
    NextAcquisition,
    ParameterEstimate,
    PredictedState,
    Summary,
)
from palpate.workers.diagnosis.plan_summary import (
    FurtherMeasurement,
    ParameterPlan,
    PlannedEffect,
    PlanSummary,
)
from palpate.workers.mechanics.model_parameters import ShownMagnitude
from palpate.workers.organs.organ_plugins import DEFAULT, catalogue_of

MOST_DIGITS = 4
# A gap below this length and this fraction of the noise counts as none.
NOTHING_MM, NOTHING_OF_NOISE = 0.005, 0.1
# The smallest printed upper limit of a gap; the noise level if that is smaller.
LEAST_MM = 0.01
# Name of the region that contains all points of an interface.
WHOLE = "all"
# Largest change in per cent that is given as visible.
MOST_CHANGE = 100.0
# A region is inside or outside the scan if its mean distance is more than this part of its gap.
ONE_SIDED = 0.5
# Words for gains in log evidence up to so many nats; the reliability of a cause is counted in the
# same bands.
STRENGTHS = (("weak", 20.0), ("clear", 50.0))
NOT_EFFECTS = {"no-gap": "no gap", "none-of-these": "none of these"}


def spoken(name: str) -> str:
    """Return the readable name of an effect, of "no-gap" or of "none-of-these".

    Examples
    --------
    >>> spoken("plate_tilt"), spoken("none-of-these")
    ('plate tilt', 'none of these')
    """
    return NOT_EFFECTS.get(name, name.replace("_", " "))


def seen_from(effect: EffectSummary) -> str:
    """Return the size from which the data would have shown an effect; a dash if at none.

    Sizes are extrapolated linearly, so changes of a ratio beyond `MOST_CHANGE` mean nothing.
    """
    size = effect.seen_from
    if size is None or not math.isfinite(size):
        return NONE
    if effect.seen_unit == "%" and size > MOST_CHANGE:
        return NONE
    return f"{number(size, 2)} {effect.seen_unit}".rstrip()


def power(summary: Summary) -> str:
    """Return the size from which each effect would have been named; empty if none would be."""
    seen = [
        f"{spoken(e.name)} {seen_from(e)}"
        for e in summary.effects
        if e.name not in summary.absorbed and seen_from(e) != NONE
    ]
    if not seen:
        return ""
    return f"These {_loaded(summary)}s would have shown, from this size on: {listed(seen)}."


def cause_gain(summary: Summary, name: str) -> float | None:
    """Return the gain of an effect in nats; None if it was not fitted.

    A further named effect has the gain that it adds to those named before it.
    """
    place = summary.primary.index(name) if name in summary.primary else 0
    if place == 0:
        return summary.effect(name).gain
    totals = {frozenset(fit.effects): fit.log_evidence_gain for fit in summary.refits}
    before = totals.get(frozenset(summary.primary[:place]))
    total = totals.get(frozenset(summary.primary[: place + 1]))
    return None if before is None or total is None else total - before


def fitted_causes(summary: Summary) -> list[tuple[EffectSummary, float]]:
    """Return the effects that were fitted with their gains: the named ones, then the best first."""
    gains = [(effect, cause_gain(summary, effect.name)) for effect in summary.effects]
    fitted = [(effect, gain) for effect, gain in gains if gain is not None]

    def order(cause: tuple[EffectSummary, float]) -> tuple[int, float]:
        effect, gain = cause
        named = summary.primary
        return named.index(effect.name) if effect.name in named else len(named), -gain

    return sorted(fitted, key=order)


def together(names: Sequence[str]) -> str:
    """Return a list of effects as text.

    Examples
    --------
    >>> together(["plate_tilt", "friction"])
    'plate tilt and friction'
    """
    return listed([spoken(name) for name in names])


def strength(gain: float | None) -> str:
    """Return the evidence of a cause in a word, from its gain in nats; None if it was not fitted.

    Examples
    --------
    >>> strength(3.0), strength(12.0), strength(30.0), strength(200.0), strength(None)
    ('none', 'weak', 'clear', 'strong', '–')
    """
    if gain is None:
        return NONE
    if gain <= SETTINGS.selection.first:
        return "none"
    return next((word for word, most in STRENGTHS if gain <= most), "strong")


def measured(value: float | None, sd: float | None, unit: str) -> str:
    """Return a magnitude with its standard deviation as text.

    Examples
    --------
    >>> measured(5.4838, 0.2712, "deg"), measured(-16.57, 1.04, "mm"), measured(None, None, "g")
    ('5.48 ± 0.27 deg', '−16.6 ± 1.0 mm', '–')
    """
    if value is None or sd is None:
        return NONE
    digits = _digits(sd)
    if digits > MOST_DIGITS:
        return f"{number(value, 3)} ± {number(sd, 2)} {unit}".rstrip()
    return f"{signed(value, digits)} ± {sd:.{digits}f} {unit}".rstrip()


def magnitude(one: ParameterEstimate | EffectSummary) -> str:
    """Return a magnitude as text, with its 90 % interval and the model's value.

    Examples
    --------
    >>> nu = ShownMagnitude(0.4503, 0.431, 0.462, 0.49, "", "nu")
    >>> magnitude(ParameterEstimate("ln_compressibility", 1.6, 0.2, "", nu))
    'nu = 0.45 (0.43 to 0.46; model: 0.49)'
    >>> magnitude(ParameterEstimate("tilt_depth_deg", 5.4838, 0.2712, "deg"))
    '5.48 ± 0.27 deg'
    """
    if one.shown is None:
        return measured(one.magnitude, one.sd, one.unit)
    value, *detail = _shown(one.shown)
    return f"{value} ({'; '.join(detail)})"


def _shown(one: ShownMagnitude) -> list[str]:
    """Return a value with its unit, its interval and the model's value."""
    digits = _digits((one.high - one.low) / 3, figures=1)

    def text(value: float) -> str:
        return number(value, 2) if digits > MOST_DIGITS else signed(value, digits)

    name = f"{one.name} = " if one.name else ""
    model = [] if one.neutral is None else [f"model: {number(one.neutral, 4)}"]
    value = f"{name}{text(one.value)} {one.unit}".rstrip()
    return [value, f"{text(one.low)} to {text(one.high)}", *model]


def difference(value: float, sd: float) -> str:
    """Return a signed number, rounded according to its standard deviation.

    Examples
    --------
    >>> difference(-0.0123, 0.02), difference(0.25, 0.1), difference(2.1e-6, 1e-6)
    ('−0.012', '+0.25', '+2·10⁻⁶')
    """
    digits = _digits(sd)
    if digits > MOST_DIGITS:
        return ("+" if value > 0 else "") + number(value, 2)
    return signed(value, digits, "+")


def _digits(sd: float, figures: int = 2) -> int:
    """Return the decimals that show the given significant digits of a standard deviation."""
    return max(0, figures - 1 - math.floor(math.log10(sd))) if sd > 0 else 3


def signed(value: float, digits: int, plus: str = "") -> str:
    """Return a number with a typographic minus, not before zero; `plus` "+" adds a plus sign.

    Examples
    --------
    >>> signed(-0.254, 2), signed(-0.001, 2), signed(0.25, 2, "+")
    ('−0.25', '0.00', '+0.25')
    """
    rounded = round(value, digits) + 0.0
    text = f"{rounded:{plus if rounded else ''}.{digits}f}"
    return text.replace("-", MINUS)


class Interval(Protocol):
    """A length with its interval, in mm."""

    @property
    def gap_mm(self) -> float:
        """Central value."""

    @property
    def low_mm(self) -> float:
        """Lower end."""

    @property
    def high_mm(self) -> float:
        """Upper end."""


def millimetres(gap: Interval | None) -> str:
    """Return a gap with its interval as text.

    Examples
    --------
    >>> millimetres(GapEstimate(0.2684, 0.2256, 0.305, 0.44, 8))
    '0.27 mm (0.23 to 0.30)'
    """
    if gap is None:
        return NONE
    middle, low, high = (length(v, gap.high_mm) for v in (gap.gap_mm, gap.low_mm, gap.high_mm))
    return f"{middle} mm ({low} to {high})"


def length(mm: float, beside: float | None = None) -> str:
    """Return a length in mm with two decimals.

    Use two significant digits if it or the length shown next to it is smaller than that.

    Examples
    --------
    >>> length(0.2684), length(0.0), length(0.00123), length(0.00004, beside=0.00123)
    ('0.27', '0.00', '0.0012', '0.0000')
    """
    digits = decimals(mm if beside is None else beside)
    return number(mm, 2) if digits > MOST_DIGITS + 1 else f"{mm:.{digits}f}"


def decimals(mm: float) -> int:
    """Return the number of decimals: two, or two significant digits of a smaller length."""
    return _digits(mm) if 0 < mm < LEAST_MM else 2


def sentence(summary: Summary) -> str:
    """Return the verdict with notes on absorbed effects and on the noise."""
    return " ".join(filter(None, (headline(summary), noise(summary))))


def headline(summary: Summary) -> str:
    """Return the verdict: where model and data differ, which cause, how far it reduces the gap."""
    return " ".join(filter(None, (*summary.doubts, _verdict(summary))))


def noise(summary: Summary) -> str:
    """Return a note on noise that is set too small or too large; else empty."""
    said = []
    for level in summary.noise or ():
        ratio = level.learnt_mm / level.stated_mm if level.stated_mm > 0 else 1.0
        if max(ratio, 1 / ratio) > SETTINGS.noise.misstated:
            wrong = "small" if ratio > 1 else "large"
            said.append(
                f"The noise of the {level.interface} interface is set too {wrong}: "
                f"{level.stated_mm:.2f} mm, but its residuals show {level.learnt_mm:.2f} mm."
            )
    return " ".join(said)


def _verdict(summary: Summary) -> str:
    gap = summary.gap_mm
    if summary.verdict == "no-gap":
        return _no_cause(summary)
    differ = _difference(summary)
    if summary.verdict == "none-of-these":
        return f"{differ} No effect in the catalogue explains it."
    if summary.verdict == "cannot-be-told-apart":
        which = (
            f"These {_loaded(summary)}s cannot decide: {together(summary.rivals)} explain it "
            f"almost equally well; the best is {_cause(summary, summary.primary[0])}."
        )
    else:
        causes = listed([_cause(summary, name) for name in summary.primary])
        names = "The cause is" if len(summary.primary) == 1 else "The causes are"
        which = f"{'A lead, not a finding:' if gap.checked_on == 'same scan' else names} {causes}."
    return " ".join(filter(None, (differ, which, _left(summary))))


def _no_cause(summary: Summary) -> str:
    gap = summary.gap_mm
    if gap.before.low_mm > gap.calibration_floor:
        return f"{_difference(summary)} It is too small or too irregular to name a cause."
    agree = "Model and data agree: the residual is no larger than the noise."
    if summary.doubts:
        agree = "The residual is no larger than the noise, which does not make the fit right."
    most = length(max(gap.before.high_mm, least_length(gap)))
    return f"{agree} A gap larger than {most} mm is unlikely."


def _difference(summary: Summary) -> str:
    """Return how large the gap is and where it is largest."""
    gap = summary.gap_mm
    if _is_nothing(gap.before, gap):
        return "The residual is below the noise level but systematic."
    worst = _worst_place(summary)
    return f"Model and data differ by {millimetres(gap.before)} beyond the noise{worst}."


def _worst_place(summary: Summary) -> str:
    """Return where the gap is largest, as the end of a sentence; empty if no place stands out."""
    states = summary.markers or ()
    if len(states) > 1:
        return f", most in the state {max(states, key=_misfit_mm).state}"
    significant = [part for part in summary.where if part.significant]
    parts = [part for part in significant if part.region != WHOLE] or significant
    if not parts:
        return ""
    most = max(parts, key=lambda part: part.gap_mm)
    region = "" if most.region == WHOLE else f"{most.region} of the "
    side = "outside" if most.signed_mean_mm > 0 else "inside"
    is_one_sided = abs(most.signed_mean_mm) > ONE_SIDED * most.gap_mm
    return (
        f", most in the {region}{most.interface} interface in the scan at {most.scan} "
        f"({length(most.gap_mm)} mm{f', the model {side}' if is_one_sided else ''})"
    )


def _misfit_mm(state: MarkerState) -> float:
    """Return the root mean square residual of the nominal model in a state."""
    values = [mm for point in state.points for mm in point.before_mm if math.isfinite(mm)]
    return math.sqrt(sum(mm**2 for mm in values) / max(len(values), 1))


def _loaded(summary: Summary) -> str:
    return "scan" if summary.markers is None else "state"


def _cause(summary: Summary, name: str) -> str:
    """Return an effect with its magnitude and, if it was fitted, its evidence."""
    effect, gain = summary.effect(name), cause_gain(summary, name)
    said = [measured(effect.magnitude, effect.sd, effect.unit)]
    if effect.shown is not None:
        said = _shown(effect.shown)
    if gain is not None:
        said.append(f"{strength(gain)} evidence")
    return f"{spoken(name)} ({', '.join(said)})"


def _left(summary: Summary) -> str:
    """Return the gap left by the effect, on held-out scans if there are any, and a warning."""
    left = _left_mm(summary)
    if not summary.something_else:
        return left
    return f"{left} A systematic rest remains: something else acts as well."


def _left_mm(summary: Summary) -> str:
    gap, scan = summary.gap_mm, _loaded(summary)
    if gap.held_out_after is not None and gap.held_out_before is not None:
        before = gap.held_out_before
        of = "" if _is_nothing(before, gap) else f" of {length(before.gap_mm)} mm"
        rest = _rest(gap.held_out_after, gap)
        return f"On {scan}s not used in the fit, it leaves {rest}{of}."
    if gap.after is None:
        return ""
    fitted = f"{scan}s" if gap.not_judged else scan
    return (
        f"It leaves {_rest(gap.after, gap)} on the {fitted} used in the fit; this was not checked "
        f"on other {scan}s."
    )


def _rest(left: GapEstimate, gap: GapSummary) -> str:
    if _is_nothing(left, gap):
        return f"nothing above the noise (at most {length(left.high_mm)} mm)"
    return millimetres(left)


def _is_nothing(one: GapEstimate, gap: GapSummary) -> bool:
    return one.gap_mm < min(NOTHING_MM, NOTHING_OF_NOISE * gap.noise_floor)


def agreement(state: PredictedState) -> str:
    """Return how a prediction agrees with the recordings of a held-out state; empty without any.

    Examples
    --------
    >>> from palpate.workers.diagnosis.outcome.diagnosis_summary import PredictedPoint
    >>> point = PredictedPoint("M", (1.0, 2.0, 3.0), (0.1, 0.1, 0.1), (1.1, 2.0, 3.5))
    >>> agreement(PredictedState("held out", (point,)))
    'measured: 2 of 3 components within two standard deviations, rms difference 0.29 mm'
    """
    found = state.agreement
    if found is None:
        return ""
    return (
        f"measured: {found.within} of {found.components} components within two standard "
        f"deviations, rms difference {number(found.rms_mm, 2)} mm"
    )


def least_length(gap: GapSummary) -> float:
    """Return the smallest upper limit of a gap to report, in mm."""
    return min(LEAST_MM, gap.noise_floor)


PLAN_DIGITS = 2
WHY_NOT_FOUND = {
    "hidden": "absorbed by the constants",
    "weak": "too weak at its plausible size",
    "": "can be found",
}


def plan_headline(plan: PlanSummary) -> str:
    """Return the findings that the planned scans allow, in two sentences."""
    scans = plan.scans
    seen = len(plan.effects) - len(plan.silent)
    ones = "One scan" if len(scans) == 1 else f"{len(scans)} scans"
    return (
        f"{ones} ({listed(scans)}) can find {seen} of {len(plan.effects)} effects at their "
        f"plausible size and distinguish {plan.told_apart} of {plan.pairs} pairs of them. "
        f"{_best_measurement(plan)}"
    ).rstrip()


def silent_effects(plan: PlanSummary) -> str:
    """Return the effects that can be neither confirmed nor ruled out; empty if none."""
    parts = []
    for why, words in (("hidden", "absorbed by the constants"), ("weak", "too weak")):
        names = [e.name for e in plan.effects if e.why_not == why]
        if names:
            parts.append(f"{together(names)} ({words})")
    return f"Neither confirmed nor ruled out: {'; '.join(parts)}." if parts else ""


def confused_effects(plan: PlanSummary) -> str:
    """Return the pairs that are detected but not distinguished; empty if there are none."""
    pairs = [
        f"{' or '.join(map(spoken, p.effects))} ({p.log_evidence:.1f})" for p in plan.confusable
    ]
    if not pairs:
        return ""
    return f"Not distinguished, with the expected log evidence in nats: {'; '.join(pairs)}."


def drift_advice(plan: PlanSummary) -> str:
    """Return the effects with meaningless numbers and a remedy; empty if there are none."""
    if not plan.loose:
        return ""
    effects = catalogue_of(DEFAULT).effects
    holding = [p.door_name for e in effects if e.holds_body for p in e.parameters]
    return (
        f"Nothing holds the body sideways: {together(plan.loose)} would push it away, so their "
        "numbers mean little. Fix it to the chest wall with springs kx and ky in case.yaml, or "
        f"{listed(holding)} under case.constants of a study."
    )


def planned_amounts(
    parameters: Sequence[ParameterPlan], which: Literal["minimum", "plausible"]
) -> str:
    """Return the magnitudes of an effect's parameters as text, with a range for each unit.

    Examples
    --------
    >>> tilts = [ParameterPlan("a", "deg", 1.04, 2.0), ParameterPlan("b", "deg", 0.13, 2.0)]
    >>> planned_amounts(tilts, "minimum")
    '0.13 to 1 deg'
    >>> planned_amounts([ParameterPlan("a", "", None, 2.0)], "minimum")
    '–'
    """
    words = []
    shown = [p.shown for p in parameters]
    for unit in dict.fromkeys(unit for *_, unit in shown):
        own = [(least, size) for least, size, other in shown if other == unit]
        known = [least if which == "minimum" else size for least, size in own]
        values = sorted(value for value in known if value is not None)
        if values:
            ends = dict.fromkeys(number(v, PLAN_DIGITS) for v in (values[0], values[-1]))
            words.append(f"{' to '.join(ends)} {unit}".rstrip())
    return ", ".join(words) or NONE


def nearest_effect(effect: PlannedEffect) -> str:
    """Return the most similar effect and the cosine."""
    if effect.nearest is None:
        return NONE
    return f"{spoken(effect.nearest)} {effect.cosine:.2f}"


def measurement_gain(acquisition: FurtherMeasurement) -> str:
    """Return a phrase on the gain from a further measurement."""
    said = []
    more = acquisition.more_told_apart
    if more > 0:
        said.append(f"{more} more {'pair' if more == 1 else 'pairs'} distinguished")
    if acquisition.reveals:
        said.append(f"reveals {together(acquisition.reveals)}")
    if acquisition.separates:
        pairs = ["{} from {}".format(*map(spoken, pair)) for pair in acquisition.separates]
        said.append(f"separates {listed(pairs)}")
    return "; ".join(said) or "no further pairs distinguished"


def _best_measurement(plan: PlanSummary) -> str:
    if not plan.acquisitions:
        return ""
    first = plan.acquisitions[0]
    if first.more_told_apart <= 0:
        return "None of the further measurements considered would distinguish more pairs."
    return f"The most informative would be {first.name}: {measurement_gain(first)}."


# Number of measurements to list.
SHOWN_ACQUISITIONS = 4


def is_undecided(summary: Summary) -> bool:
    """Check whether several causes remain possible."""
    return summary.verdict == "cannot-be-told-apart"


def next_acquisitions(summary: Summary, plan: PlanSummary) -> tuple[NextAcquisition, ...]:
    """Rank the measurements evaluated in a plan, the most decisive first.

    The criteria are the number of pairs of rivals that are distinguished, then the number
    of absorbed effects that are revealed, then the order of the plan.

    Parameters
    ----------
    summary : Summary
    plan : PlanSummary
        Plan for the same scans.
    """
    suspects = {frozenset(p) for p in combinations(_suspects(summary), 2)}
    hidden = set(summary.absorbed)
    options = [
        NextAcquisition(
            name=acquisition.name,
            separates=tuple(pair for pair in acquisition.separates if frozenset(pair) in suspects),
            reveals=tuple(name for name in acquisition.reveals if name in hidden),
            minimum_ratio=acquisition.minimum_ratio,
        )
        for acquisition in plan.acquisitions
    ]
    ranked = sorted(options, key=lambda one: (-len(one.separates), -len(one.reveals)))
    return tuple(ranked[:SHOWN_ACQUISITIONS])


def acquisition_worth(option: NextAcquisition) -> str:
    """Return a phrase on what a measurement would decide.

    Examples
    --------
    >>> acquisition_worth(NextAcquisition("a view", (("gravity_change", "fibre_fan"),), (), 0.62))
    'distinguishes gravity change from fibre fan; detection limits become 0.62 times as large'
    """
    pairs = [f"{spoken(a)} from {spoken(b)}" for a, b in option.separates]
    words = [f"distinguishes {listed(pairs)}"] if pairs else []
    if option.reveals:
        words.append(f"reveals {together(option.reveals)}")
    words.append(f"detection limits become {option.minimum_ratio:.2f} times as large")
    return "; ".join(words)


def _suspects(summary: Summary) -> list[str]:
    return list(summary.rivals)
