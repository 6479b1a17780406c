"""Formatted table rows of a diagnosis."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup

from palpate.service.diagnosis.quotability import JudgedConstant, judged_constants, unit_of
from palpate.service.diagnosis.words import (
    bayes_factor,
    likely,
    magnitude,
    millimetres,
    signed,
    spoken,
)
from palpate.service.formatting import NONE, number, percent, signed_error, symbol
from palpate.service.results.quotable import Bounds
from palpate.workers.diagnosis.schema import summary as schema

Pair = tuple[str, str]


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
    probability: str
    magnitudes: tuple[tuple[str, str], ...]
    factor: str
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
class OverlapRow:
    """Overlap scores of one interface of a scan, as pairs: nominal model and effect."""

    scan: str
    interface: str
    jc: Pair
    reachable: str
    mhd: Pair
    gsf: Pair
    median: Pair
    p95: Pair
    mean: Pair


def constants(summary: schema.Summary) -> list[ConstantRow]:
    """Return a row for each constant, for the nominal model and with the effect."""
    return [
        _constant(name, summary.constants[name], judged)
        for name, judged in judged_constants(summary).items()
    ]


def _constant(name: str, value: schema.ConstantEstimate, judged: JudgedConstant) -> ConstantRow:
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


def effects(found: Iterable[schema.EffectSummary], absorbed: Iterable[str]) -> list[EffectRow]:
    """Return the effects by descending probability, absorbed ones last."""
    hidden = set(absorbed)

    def order(e: schema.EffectSummary) -> tuple[bool, float, float]:
        return e.name in hidden, -round(e.probability, 2), -e.log_bayes_factor

    ranked = sorted(found, key=order)
    return [_effect(e, e.name in hidden) for e in ranked]


def regions(found: Iterable[schema.RegionGap]) -> list[RegionRow]:
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


def overlap(found: Iterable[schema.OverlapRow]) -> list[OverlapRow]:
    """Return a row for every interface of every scan."""
    return [
        OverlapRow(
            scan=r.scan,
            interface=r.interface,
            jc=_pair(r, "jc", 3),
            reachable=_fixed(r.reachable_jc, 3),
            mhd=_pair(r, "mhd_mm", 2),
            gsf=_pair(r, "gsf", 2),
            median=_pair(r, "p50_mm", 2),
            p95=_pair(r, "p95_mm", 2),
            mean=_pair(r, "signed_mean_mm", 2),
        )
        for r in found
    ]


def _pair(row: schema.OverlapRow, figure: str, digits: int) -> Pair:
    after = None if row.after is None else getattr(row.after, figure)
    return _fixed(getattr(row.before, figure), digits), _fixed(after, digits)


def _fixed(value: float | None, digits: int) -> str:
    """Return a number with fixed decimals, a dash for none, and a sign for infinity."""
    if value is None or not math.isfinite(value):
        return number(value)
    return signed(value, digits)


def _effect(e: schema.EffectSummary, hidden: bool) -> EffectRow:
    magnitudes = tuple((parameter_name(p.parameter, p.unit), magnitude(p)) for p in e.parameters)
    share = f"{100 * e.absorbed_share:.0f} %"
    why = f"the constants absorb {share} of it: the scans cannot reveal it"
    return EffectRow(
        spoken(e.name),
        e.summary,
        e.family,
        NONE if hidden else likely(e.probability),
        magnitudes,
        bayes_factor(e.log_bayes_factor),
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
