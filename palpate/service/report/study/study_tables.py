"""Formatted table rows of a study's page."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from palpate.service.number_formatting import (
    beside,
    count,
    duration,
    number,
    signed_error,
    small_percent,
    symbol,
)
from palpate.service.report.study.study_consequence import interval_text, verdicts
from palpate.service.results.identification import Identification
from palpate.service.results.result_records import ParameterEstimate, StageTime
from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.storage.values import BodyFacts, OutcomeJson, Scores
from palpate.workers.organs.organ_plugins import Fact, organ_plugin


@dataclass(frozen=True)
class ParameterRow:
    """A searched parameter: its estimate, interval, target and bounds."""

    symbol: Markup
    unit: str
    estimate: str
    target: str
    error: str
    bounds: str
    edge: bool
    interval: str
    verdict: str


@dataclass(frozen=True)
class SimilarityRow:
    """Scores of a tissue, as (before, after) texts."""

    tissue: str
    searched: bool
    jc: tuple[str, str]
    dice: tuple[str, str]
    mhd_mm: tuple[str, str]
    mhd_voxels: tuple[str, str]
    gsf: tuple[str, str]


@dataclass(frozen=True)
class FailureRow:
    """An evaluation without a score."""

    candidate: int
    generation: int
    status: str
    constants: tuple[str, ...]
    reason: str
    traceback: str


@dataclass(frozen=True)
class StageRow:
    """Time spent by evaluations in one stage."""

    name: str
    total: str
    each: str
    share: str


def parameter_table(
    estimates: Mapping[str, ParameterEstimate], known: Identification | None = None
) -> list[ParameterRow]:
    """Return a row for each parameter: estimate, interval, target and bounds."""
    constants = {} if known is None else known.constants
    words = verdicts(known, estimates)
    return [
        ParameterRow(
            symbol=symbol(name, e.unit),
            unit=e.unit,
            estimate=beside(e.estimate, e.target),
            target=number(e.target, 3),
            error=small_percent(signed_error(e.estimate, e.target)),
            bounds=f"{number(e.lower)} … {number(e.upper)}",
            edge=e.at_bound,
            interval=e.interval_text if e.one_sided else interval_text(constants.get(name)),
            verdict=words[name],
        )
        for name, e in estimates.items()
    ]


def similarity_table(
    before: Mapping[str, Scores], after: Mapping[str, Scores], searched: Iterable[str]
) -> list[SimilarityRow]:
    """Return a row of scores for each tissue, the searched tissues first."""
    compared = set(searched)
    return [
        _similarity(tissue, tissue in compared, before.get(tissue, {}), after.get(tissue, {}))
        for tissue in sorted({*before, *after}, key=lambda t: (t not in compared, t))
    ]


def _similarity(tissue: str, searched: bool, before: Scores, after: Scores) -> SimilarityRow:
    return SimilarityRow(
        tissue,
        searched,
        jc=(number(before.get("jc"), 4), number(after.get("jc"), 4)),
        dice=(number(before.get("dice"), 4), number(after.get("dice"), 4)),
        mhd_mm=(number(before.get("mhd_mm"), 3), number(after.get("mhd_mm"), 3)),
        mhd_voxels=(number(before.get("mhd_voxels"), 3), number(after.get("mhd_voxels"), 3)),
        gsf=(number(before.get("gsf"), 4), number(after.get("gsf"), 4)),
    )


def failure_table(
    endings: Iterable[EvaluationRecord], units: Mapping[str, str]
) -> list[FailureRow]:
    """Return a row for every evaluation without a score, in the order of the candidates."""
    return [
        FailureRow(
            record.candidate,
            record.generation + 1,
            record.status.value,
            tuple(_constant(name, value, units) for name, value in record.genes.items()),
            record.reason,
            record.traceback,
        )
        for record in sorted(endings, key=lambda r: r.candidate)
        if record.status is not Status.DONE
    ]


def _constant(name: str, value: float, units: Mapping[str, str]) -> Markup:
    unit = units.get(name, "")
    return symbol(name, unit) + f" {number(value)} {unit}".rstrip()


def stage_table(times: Mapping[str, StageTime]) -> list[StageRow]:
    """Return a row for each stage, with the time of the computed evaluations."""
    total_s = sum(time.total_s for time in times.values())
    return [
        StageRow(
            stage,
            duration(time.total_s),
            duration(time.mean_s),
            f"{100 * time.total_s / total_s:.1f} %" if total_s else "",
        )
        for stage, time in times.items()
    ]


def solver_table(solver: OutcomeJson) -> list[tuple[str, str | Markup]]:
    """Return the solver's figures for the best simulation, without missing ones."""
    rows: list[tuple[str, str | Markup]] = []
    for name, value, unit, digits in (
        ("Displacement of the apex", solver.get("apex_displacement_um"), "µm", 4),
        ("Plate displacement", solver.get("plate_displacement_mm"), "mm", 4),
        ("Force on the plate", solver.get("plate_force_n"), "N", 4),
        ("Contact area", solver.get("contact_area_mm2"), "mm²", 4),
        ("Deepest penetration of a plate", solver.get("penetration_mm"), "mm", 3),
        ("Stored energy", solver.get("energy_mj"), "mJ", 4),
        ("Smallest volume ratio J", solver.get("min_j"), "", 4),
        ("Force balance of the plates, relative", solver.get("force_imbalance"), "", 3),
        ("Force of the chest wall", solver.get("wall_force_n"), "N", 3),
        ("Residual force", solver.get("residual_n"), "N", 3),
    ):
        if isinstance(value, int | float):
            rows.append((name, f"{number(value, digits)} {unit}".rstrip()))
    for name, iterations in (
        ("Newton steps", solver.get("newton_iterations")),
        ("Linear iterations", solver.get("cg_iterations")),
    ):
        if iterations:
            levels = " + ".join(count(n) for n in iterations)
            rows.append((f"{name}, coarse to fine mesh", levels))
    return rows


def case_table(organ: str, facts: BodyFacts) -> list[tuple[str, str]]:
    """Return the organ's description of body and mesh."""
    known: Mapping[str, Any] = facts
    rows = [(f.label, _fact(known[f.key], f)) for f in organ_plugin(organ).facts if f.key in known]
    if "voxels" in known:
        sides = " × ".join(number(s) for s in known.get("spacing_mm", ()))
        rows.append(("Voxels of the body", f"{count(known['voxels'])} of {sides} mm"))
    return rows


def _fact(value: Any, fact: Fact) -> str:
    if isinstance(value, float):
        return f"{number(fact.factor * value, 3)} {fact.unit}".rstrip()
    counts = value if isinstance(value, list) else [value]
    return " > ".join(count(n) for n in counts)
