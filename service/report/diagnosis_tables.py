"""The rows of a diagnosis' tables, ready to print."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from service.diagnosis.words import likely, measured, millimetres, signed, spoken
from service.report.words import NONE, number, percent, signed_error, symbol

Json = Mapping[str, Any]
Pair = tuple[str, str]


@dataclass(frozen=True)
class ConstantRow:
    """A constant before and after an effect is taken into account."""

    symbol: Markup
    before: str
    after: str
    change: str


@dataclass(frozen=True)
class EffectRow:
    """What is known of one effect; `hidden` if no data could show it, and then `why`."""

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
    """How one interface of a scan is matched; pairs are the nominal model and the effect."""

    scan: str
    interface: str
    jc: Pair
    reachable: str
    mhd: Pair
    gsf: Pair
    median: Pair
    p95: Pair
    mean: Pair


def constants(found: Json) -> list[ConstantRow]:
    """Of the nominal model, and with the effect."""
    return [
        ConstantRow(
            symbol(name, "kPa"),
            number(value["before"]),
            number(value["after"]),
            percent(signed_error(value["after"], value["before"])),
        )
        for name, value in found.items()
    ]


def effects(found: Iterable[Json], absorbed: Iterable[str]) -> list[EffectRow]:
    """The most probable first; those that the constants hide at the end."""
    hidden = set(absorbed)

    def order(e: Json) -> tuple[bool, float, float]:
        return e["name"] in hidden, -round(e["probability"], 2), -e["log_bayes_factor"]

    ranked = sorted(found, key=order)
    return [_effect(e, e["name"] in hidden) for e in ranked]


def regions(found: Iterable[Json]) -> list[RegionRow]:
    """Every region of every interface and scan."""
    return [
        RegionRow(
            r["scan"],
            r["interface"],
            r["region"],
            millimetres(r),
            signed(r["signed_mean_mm"], 2, "+"),
            _fixed(r.get("p50_mm"), 2),
            _fixed(r.get("p95_mm"), 2),
            str(r["points"]),
            r["significant"],
        )
        for r in found
    ]


def overlap(found: Iterable[Json]) -> list[OverlapRow]:
    """Every interface of every scan, as `workers.pictures.drawings.overlap_rows` has them."""
    rows = []
    for r in found:
        before, after = r["before"], r["after"] or {}

        def pair(key: str, digits: int, before: Json = before, after: Json = after) -> Pair:
            return _fixed(before[key], digits), _fixed(after.get(key), digits)

        rows.append(
            OverlapRow(
                scan=r["scan"],
                interface=r["interface"],
                jc=pair("jc", 3),
                reachable=_fixed(r["reachable_jc"], 3),
                mhd=pair("mhd_mm", 2),
                gsf=pair("gsf", 2),
                median=pair("p50_mm", 2),
                p95=pair("p95_mm", 2),
                mean=pair("signed_mean_mm", 2),
            )
        )
    return rows


def _fixed(value: float | None, digits: int) -> str:
    """A number with so many decimals; no number is a dash, and infinite ones have a sign."""
    if value is None or not math.isfinite(value):
        return number(value)
    return signed(value, digits)


def _effect(e: Json, hidden: bool) -> EffectRow:
    magnitudes = tuple(
        (_parameter(p), measured(p["magnitude"], p["sd"], p["unit"])) for p in e["parameters"]
    )
    share = f"{100 * e['absorbed_share']:.0f} %"
    why = f"{share} of it looks like another choice of constants: the scans cannot show it"
    return EffectRow(
        spoken(e["name"]),
        e["summary"],
        e["family"],
        NONE if hidden else likely(e["probability"]),
        magnitudes,
        number(e["log_bayes_factor"], 3),
        share,
        hidden,
        why if hidden else "",
    )


def _parameter(p: Json) -> str:
    """The name of a parameter without its unit."""
    ending = f"_{p['unit'].lower().replace('/', '_per_')}" if p["unit"] else ""
    return str(p["parameter"]).removesuffix(ending).replace("_", " ")
