"""The rows of a report's tables, ready to print."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from service.report.words import (
    at_edge,
    count,
    duration,
    number,
    percent,
    powers,
    signed_error,
    symbol,
)
from storage.records import EvaluationRecord
from storage.status import Status

Scores = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Row:
    """A searched parameter: what was found, and what is known."""

    symbol: Markup
    unit: str
    estimate: str
    target: str
    error: str
    bounds: str
    edge: bool


@dataclass(frozen=True)
class Similarity:
    """A tissue before and after the fit, as (before, after) texts."""

    tissue: str
    searched: bool
    jc: tuple[str, str]
    dice: tuple[str, str]
    mhd_mm: tuple[str, str]
    mhd_voxels: tuple[str, str]
    gsf: tuple[str, str]


@dataclass(frozen=True)
class Failure:
    """An evaluation without a score."""

    candidate: int
    generation: int
    status: str
    constants: tuple[str, ...]
    reason: str
    traceback: str


@dataclass(frozen=True)
class Stage:
    """Time that evaluations spent in one stage."""

    name: str
    total: str
    each: str
    share: str


def parameters(estimates: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """Estimates beside targets and bounds."""
    rows = []
    for name, found in estimates.items():
        unit, estimate, bounds = found["unit"] or "", found["estimate"], found["bounds"]
        row = Row(
            symbol=symbol(name, unit),
            unit=unit,
            estimate=number(estimate),
            target=number(found["target"]),
            error=percent(signed_error(estimate, found["target"])),
            bounds=f"{number(bounds[0])} … {number(bounds[1])}",
            edge=estimate is not None and at_edge(estimate, bounds),
        )
        rows.append(row)
    return rows


def similarities(before: Scores, after: Scores, searched: Iterable[str]) -> list[Similarity]:
    """Scores tissue by tissue; the searched tissues first."""
    compared = set(searched)
    rows = []
    for tissue in sorted({*before, *after}, key=lambda t: (t not in compared, t)):

        def pair(key: str, digits: int, tissue: str = tissue) -> tuple[str, str]:
            first, second = (s.get(tissue, {}).get(key) for s in (before, after))
            return number(first, digits), number(second, digits)

        row = Similarity(
            tissue, tissue in compared, pair("jc", 4), pair("dice", 4), pair("mhd_mm", 3),
            pair("mhd_voxels", 3), pair("gsf", 4),
        )  # fmt: skip
        rows.append(row)
    return rows


def failures(
    endings: Iterable[EvaluationRecord], units: Mapping[str, str]
) -> list[Failure]:  # fmt: skip
    """Every evaluation without a score, in the order of the candidates."""
    rows = []
    for record in sorted(endings, key=lambda r: r.candidate):
        if record.status is Status.DONE:
            continue
        constants = tuple(
            symbol(name, units.get(name, "")) + f" {number(value)} {units.get(name, '')}".rstrip()
            for name, value in record.genes.items()
        )
        row = Failure(
            record.candidate, record.generation + 1, record.status.value, constants,
            record.reason, record.traceback,
        )  # fmt: skip
        rows.append(row)
    return rows


def stages(spent: Mapping[str, Mapping[str, float]]) -> list[Stage]:
    """Where the time of the evaluations went.

    Parameters
    ----------
    spent : mapping of str to mapping
        By stage: ``total`` and ``mean`` in s, over the evaluations that were computed.
    """
    whole = sum(stage["total"] for stage in spent.values())
    return [
        Stage(
            name,
            duration(stage["total"]),
            duration(stage["mean"]),
            f"{100 * stage['total'] / whole:.1f} %" if whole else "",
        )
        for name, stage in spent.items()
    ]


def outcome(told: Mapping[str, Any]) -> list[tuple[str, str | Markup]]:
    """What the solver says of the best simulation; keys that it does not tell are left out."""
    lines: Sequence[tuple[str, str, str, int]] = (
        ("Plate displacement", "plate_displacement_mm", "mm", 4),
        ("Force on the plate", "plate_force_n", "N", 4),
        ("Contact area", "contact_area_mm2", "mm²", 4),
        ("Deepest penetration of a plate", "penetration_mm", "mm", 3),
        ("Stored energy", "energy_mj", "mJ", 4),
        ("Smallest volume ratio J", "min_j", "", 4),
        ("Force balance of the plates, relative", "force_imbalance", "", 3),
        ("Force of the chest wall", "wall_force_n", "N", 3),
        ("Residual force", "residual_n", "N", 3),
    )
    rows: list[tuple[str, str | Markup]] = [
        (name, powers(f"{number(told[key], digits)} {unit}".rstrip()))
        for name, key, unit, digits in lines
        if isinstance(told.get(key), int | float)
    ]
    for name, key in (("Newton steps", "newton"), ("Linear iterations", "cg")):
        if told.get(f"{key}_iterations"):
            levels = " + ".join(count(n) for n in told[f"{key}_iterations"])
            rows.append((f"{name}, coarse to fine mesh", levels))
    return rows


def case(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What body and mesh are like."""
    rows = []
    if "volume_ml" in facts:
        rows.append(("Volume of the body", f"{number(facts['volume_ml'])} ml"))
    if "glandular_fraction" in facts:
        rows.append(("Glandular share", f"{100 * facts['glandular_fraction']:.1f} %"))
    if "voxels" in facts:
        sides = " × ".join(number(s) for s in facts.get("spacing_mm", ()))
        rows.append(("Voxels of the body", f"{count(facts['voxels'])} of {sides} mm"))
    if "nodes" in facts:
        rows.append(("Nodes of the mesh", count(facts["nodes"])))
        rows.append(("Tetrahedra", count(facts["tets"])))
        rows.append(("Meshes, coarse to fine", " > ".join(count(n) for n in facts["levels"])))
        rows.append(("Element size", f"{number(facts['element_size_mm'], 3)} mm"))
    return rows
