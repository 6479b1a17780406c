"""The rows of a diagnosis' tables, ready to print."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from service.diagnosis.words import likely, measured, millimetres, signed, spoken
from service.report.words import NONE, number, percent, signed_error, symbol

Json = Mapping[str, Any]


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
    points: str
    significant: bool


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
            str(r["points"]),
            r["significant"],
        )
        for r in found
    ]


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
