"""Tables of a diagnosis, as formatted rows.

Every diagnosis has constants and effects, one of scans also regions and overlap. A bench experiment
has markers, forces, states, constants that undetectable effects would change, and predictions for
states that were not measured.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from palpate.service.diagnosis.diagnosed_constants import JudgedConstant, judged_constants, unit_of
from palpate.service.diagnosis.diagnosis_words import (
    agreement,
    fitted_causes,
    least_length,
    seen_from,
    spoken,
    strength,
)
from palpate.service.diagnosis.magnitude_words import (
    decimals,
    difference,
    length,
    magnitude,
    measured,
    millimetres,
    signed,
)
from palpate.service.number_formatting import NONE, number, percent, signed_error, symbol
from palpate.service.results.physical_limits import Bounds
from palpate.storage.values import Triple
from palpate.workers.diagnosis.outcome import diagnosis_summary as schema
from palpate.workers.diagnosis.outcome.diagnosis_summary import PredictedPoint, Summary

PairOfTexts = tuple[str, str]


@dataclass(frozen=True)
class ConstantRow:
    """Estimates of a constant without and with the effect, and their 90 % intervals."""

    symbol: Markup
    before: str
    after: str
    change: str
    unit: str
    interval: str
    quotable: str


@dataclass(frozen=True)
class EffectRow:
    """One effect; `hidden` if no data could reveal it, with the reason in `why`."""

    name: str
    summary: str
    family: str
    evidence: str
    magnitudes: tuple[tuple[str, str], ...]
    gain: str
    seen_from: str
    absorbed: str
    hidden: bool
    why: str


@dataclass(frozen=True)
class RegionRow:
    """The gap of one part of an interface in one scan."""

    scan: str
    interface: str
    region: str
    gap: str
    mean: str
    median: str
    p95: str
    points: str
    significant: bool


@dataclass(frozen=True)
class OverlapTexts:
    """Overlap scores of one interface of a scan, as pairs: nominal model and effect."""

    scan: str
    interface: str
    jc: PairOfTexts
    reachable: str
    mhd: PairOfTexts
    gsf: PairOfTexts
    median: PairOfTexts
    p95: PairOfTexts
    mean: PairOfTexts


def constant_table(summary: schema.Summary) -> list[ConstantRow]:
    """Return a row for each constant, for the nominal model and with the effect."""
    return [
        _constant_row(name, summary.constants[name], judged)
        for name, judged in judged_constants(summary).items()
    ]


def _constant_row(name: str, value: schema.ConstantEstimate, judged: JudgedConstant) -> ConstantRow:
    before, after = (value.before, value.after) if judged.answer.estimated else (None, None)
    return ConstantRow(
        symbol(name, "kPa"),
        number(before),
        number(after),
        percent(signed_error(after, before)),
        unit_of(name) or "none",
        _interval(judged.interval),
        "yes" if judged.answer.quotable else "no",
    )


def _interval(ends: Bounds | None) -> str:
    return NONE if ends is None else f"{number(ends[0], 3)} … {number(ends[1], 3)}"


def effect_table(summary: schema.Summary) -> list[EffectRow]:
    """Return the fitted effects, the others as ranked by the screening, and absorbed ones last."""
    hidden, fitted = set(summary.absorbed), fitted_causes(summary)
    names = {effect.name for effect, _ in fitted}
    others = [effect for effect in summary.effects if effect.name not in names]
    others.sort(key=lambda effect: -effect.log_bayes_factor)
    causes = [*fitted, *((effect, None) for effect in others)]
    causes.sort(key=lambda cause: cause[0].name in hidden)
    return [_effect_row(effect, gain, effect.name in hidden) for effect, gain in causes]


def region_table(found: Iterable[schema.RegionGap]) -> list[RegionRow]:
    """Return every region of every interface and scan."""
    return [
        RegionRow(
            r.scan,
            r.interface,
            r.region,
            millimetres(r),
            signed(r.signed_mean_mm, 2, "+"),
            _fixed(r.p50_mm, 2),
            _fixed(r.p95_mm, 2),
            str(r.points),
            r.significant,
        )
        for r in found
    ]


def overlap_table(found: Iterable[schema.OverlapRow]) -> list[OverlapTexts]:
    """Return a row for every interface of every scan."""
    return [
        OverlapTexts(
            scan=r.scan,
            interface=r.interface,
            jc=_overlap_pair(r, "jc", 3),
            reachable=_fixed(r.reachable_jc, 3),
            mhd=_overlap_pair(r, "mhd_mm", 2),
            gsf=_overlap_pair(r, "gsf", 2),
            median=_overlap_pair(r, "p50_mm", 2),
            p95=_overlap_pair(r, "p95_mm", 2),
            mean=_overlap_pair(r, "signed_mean_mm", 2),
        )
        for r in found
    ]


def _overlap_pair(row: schema.OverlapRow, figure: str, digits: int) -> PairOfTexts:
    after = None if row.after is None else getattr(row.after, figure)
    return _fixed(getattr(row.before, figure), digits), _fixed(after, digits)


def _fixed(value: float | None, digits: int) -> str:
    """Return a number with fixed decimals, a dash for none, and a sign for infinity."""
    if value is None or not math.isfinite(value):
        return number(value)
    return signed(value, digits)


def _effect_row(e: schema.EffectSummary, gain: float | None, hidden: bool) -> EffectRow:
    magnitudes = tuple((parameter_name(p.parameter, p.unit), magnitude(p)) for p in e.parameters)
    share = f"{100 * e.absorbed_share:.0f} %"
    why = f"the constants absorb {share} of it: the scans cannot reveal it"
    return EffectRow(
        spoken(e.name),
        e.summary,
        e.family,
        NONE if hidden else strength(gain),
        magnitudes,
        NONE if gain is None else signed(gain, 1),
        NONE if hidden else seen_from(e),
        share,
        hidden,
        why if hidden else "",
    )


def parameter_name(name: str, unit: str) -> str:
    """Return the name of a parameter without its unit; for a logarithm, of the ratio.

    Examples
    --------
    >>> parameter_name("tilt_depth_deg", "deg"), parameter_name("inclusion_ln_ratio", "")
    ('tilt depth', 'inclusion ratio')
    """
    ending = f"_{unit.lower().replace('/', '_per_')}" if unit else ""
    return " ".join(part for part in name.removesuffix(ending).split("_") if part != "ln")


@dataclass(frozen=True)
class MarkerRow:
    """One marker in one state; triples are along x, y and z of the body."""

    state: str
    name: str
    moved: str
    before: str
    after: str


@dataclass(frozen=True)
class ForceRow:
    """One reading of a load cell, and the residuals of the models, in N."""

    state: str
    place: str
    force: str
    before: str
    after: str


@dataclass(frozen=True)
class StateRow:
    """Misfit of all markers of a state, and the difference between repeats."""

    state: str
    before: str
    after: str
    repeats: str


@dataclass(frozen=True)
class HiddenRow:
    """The value of a constant with and without an effect that it absorbs."""

    effect: str
    size: str
    constant: str
    without: str
    along: str


@dataclass(frozen=True)
class ExpectedRow:
    """The predicted displacement of a marker, and the measured one of a held-out state."""

    state: str
    name: str
    moved: tuple[str, str, str]
    measured: str


@dataclass(frozen=True)
class ExpectedForceRow:
    """The predicted force in N on a region in a state that was not measured."""

    state: str
    place: str
    force: str


def marker_table(summary: Summary) -> list[MarkerRow]:
    """Return a row for each marker of each state."""
    digits = decimals(summary.gap_mm.noise_floor)
    return [
        MarkerRow(
            state.state,
            point.name,
            _triple(point.displacement_mm, digits),
            _triple(point.before_mm, digits),
            _triple(point.after_mm, digits),
        )
        for state in summary.markers or ()
        for point in state.points
    ]


def force_table(summary: Summary) -> list[ForceRow]:
    """Return a row for each reading of each state."""
    return [
        ForceRow(
            state.state,
            reaction.place,
            measured(reaction.force_n, reaction.sd_n, ""),
            difference(reaction.before_n, reaction.sd_n),
            NONE if reaction.after_n is None else difference(reaction.after_n, reaction.sd_n),
        )
        for state in summary.markers or ()
        for reaction in state.reactions
    ]


def state_table(summary: Summary) -> list[StateRow]:
    """Return a row for each state."""
    return [
        StateRow(
            state.state,
            _rms([point.before_mm for point in state.points]),
            _rms([point.after_mm for point in state.points]),
            NONE if state.repeats_mm is None else length(state.repeats_mm),
        )
        for state in summary.markers or ()
    ]


def hidden_table(summary: Summary) -> list[HiddenRow]:
    """Return a row for each constant that an undetectable effect would change."""
    return [
        HiddenRow(
            spoken(effect.name),
            ", ".join(
                f"{name.replace('_', ' ')} {number(v, 2)}" for name, v in effect.size.items()
            ),
            name,
            number(kpa["without"], 3),
            number(kpa["with"], 3),
        )
        for effect in summary.hidden or ()
        for name, kpa in effect.constants_kpa.items()
    ]


def expected_table(summary: Summary) -> list[ExpectedRow]:
    """Return a row for each marker of each predicted state."""
    least_mm = least_length(summary.gap_mm)
    digits = decimals(least_mm)
    return [
        ExpectedRow(
            state.state, point.name, _deviating(point, least_mm), _triple(point.measured_mm, digits)
        )
        for state in summary.predictions or ()
        for point in state.points
    ]


def agreements(summary: Summary) -> list[PairOfTexts]:
    """Return the name of each held-out state and how its recordings agree with the prediction."""
    states = summary.predictions or ()
    return [(state.state, text) for state in states if (text := agreement(state))]


def expected_force_table(summary: Summary) -> list[ExpectedForceRow]:
    """Return a row for each force of each predicted state."""
    return [
        ExpectedForceRow(state.state, one.place, measured(one.force_n, one.sd_n, ""))
        for state in summary.predictions or ()
        for one in state.reactions
    ]


def _triple(values: Triple | None, digits: int) -> str:
    if values is None:
        return NONE
    return ", ".join(NONE if math.isnan(v) else signed(v, digits) for v in values)


def _deviating(point: PredictedPoint, least_mm: float) -> tuple[str, str, str]:
    x, y, z = (
        NONE if math.isnan(value) else measured(value, max(sd, least_mm), "")
        for value, sd in zip(point.displacement_mm, point.sd_mm, strict=True)
    )
    return x, y, z


def _rms(residuals: Sequence[Triple | None]) -> str:
    known = [triple for triple in residuals if triple is not None]
    if len(known) < len(residuals):
        return NONE
    return length(float(np.sqrt(np.nanmean(np.square(known)))))
