"""The verdict of a diagnosis in words, for readers who know the images but not the statistics."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from palpate.service.diagnosis.magnitude_words import (
    LEAST_MM,
    length,
    measured,
    millimetres,
    shown_parts,
)
from palpate.service.number_formatting import NONE, listed, number
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    EffectSummary,
    GapEstimate,
    GapSummary,
    MarkerState,
    PredictedState,
    Summary,
)

# A gap below this length and this fraction of the noise counts as none.
NOTHING_MM, NOTHING_OF_NOISE = 0.005, 0.1
# Solvers of the same model of a breast differ by up to this length at the points of its interfaces.
SOLVERS_DIFFER_MM = 0.15
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
        return "faint" if gain > SETTINGS.selection.first_measured else "none"
    return next((word for word, most in STRENGTHS if gain <= most), "strong")


def sentence(summary: Summary) -> str:
    """Return the verdict with a note on the noise."""
    return " ".join(filter(None, (headline(summary), noise(summary))))


class Answers(NamedTuple):
    """The verdict as answers to three questions, each empty if there is none.

    Parameters
    ----------
    where : str
        How large the gap is, and where it is largest.
    which : str
        The causes that explain it.
    how_far : str
        What they leave of it.
    """

    where: str
    which: str = ""
    how_far: str = ""


def headline(summary: Summary) -> str:
    """Return the verdict: where model and data differ, which cause, how far it reduces the gap."""
    return " ".join(filter(None, (*summary.doubts, *answers(summary))))


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


def answers(summary: Summary) -> Answers:
    """Return where model and data differ, which cause explains it, and how far it shrinks."""
    if summary.verdict == "no-gap":
        return _no_cause(summary)
    differ = _difference(summary)
    if summary.verdict == "none-of-these":
        return Answers(differ, "No effect in the catalogue explains it.")
    return Answers(differ, _which(summary), _left(summary))


def _which(summary: Summary) -> str:
    """Return the named causes, or those that these data cannot distinguish."""
    if is_undecided(summary):
        return (
            f"These {_loaded(summary)}s cannot decide: {together(summary.rivals)} explain it "
            f"almost equally well; the best is {_cause(summary, summary.primary[0])}."
        )
    causes = listed([_cause(summary, name) for name in summary.primary])
    names = "The cause is" if len(summary.primary) == 1 else "The causes are"
    is_lead = summary.gap_mm.checked_on == "same scan"
    return f"{'A lead, not a finding:' if is_lead else names} {causes}."


def is_undecided(summary: Summary) -> bool:
    """Check whether several causes remain possible."""
    return summary.verdict == "cannot-be-told-apart"


def _no_cause(summary: Summary) -> Answers:
    gap = summary.gap_mm
    if gap.before.low_mm > gap.calibration_floor:
        return Answers(_difference(summary), "It is too small or too irregular to name a cause.")
    agree = "Model and data agree: the residual is no larger than the noise."
    if summary.doubts:
        agree = "The residual is no larger than the noise, which does not make the fit right."
    most = length(max(gap.before.high_mm, least_length(gap)))
    return Answers(f"{agree} A gap larger than {most} mm is unlikely.")


def _difference(summary: Summary) -> str:
    """Return how large the gap is and where it is largest."""
    gap = summary.gap_mm
    if _is_nothing(gap.before, gap):
        return "The residual is below the noise level but systematic."
    worst = _worst_place(summary)
    differ = f"Model and data differ by {millimetres(gap.before)} beyond the noise{worst}."
    is_small = summary.noise is not None and gap.before.gap_mm < SOLVERS_DIFFER_MM
    return f"{differ} Two solvers of one model may differ by as much." if is_small else differ


def _worst_place(summary: Summary) -> str:
    """Return where the gap is largest, as the end of a sentence; empty if no place stands out."""
    states = summary.markers or ()
    if len(states) > 1:
        return f", most in the state {max(states, key=_misfit_mm).state}"
    regions = [part for part in summary.where if part.region != WHOLE] or summary.where
    most = max(regions, key=lambda part: part.gap_mm, default=None)
    if most is None or not most.significant:
        return ""
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
        said = shown_parts(effect.shown)
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
        if gap.chosen_again is None:
            return f"On {scan}s left out of the fit, it leaves {rest}{of}."
        others = f"Chosen and fitted on the other {scan}s, it leaves {rest}{of}."
        lost = [name for name in gap.held_out_each or () if name not in gap.chosen_again]
        alone = f" Without the {scan} at {listed(lost)}, it would not be chosen." if lost else ""
        return f"{others}{alone}"
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
