"""The page of a plan, in one self-contained file, with its charts.

The charts show the similarity of effects, and the benefits of further measurements.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from palpate.service.diagnosis.diagnosis_words import spoken, together
from palpate.service.diagnosis.plan_words import (
    PLAN_DIGITS,
    WHY_NOT_FOUND,
    confused_effects,
    drift_advice,
    measurement_gain,
    nearest_effect,
    plan_headline,
    silent_effects,
)
from palpate.service.installed_packages import palpate_version
from palpate.service.number_formatting import NONE, number
from palpate.service.report.diagnosis.diagnosis_tables import parameter_name
from palpate.service.report.drawing.colours import BLUE, GREY, INK, ORANGE, SOFT_INK
from palpate.service.report.drawing.matplotlib_figures import (
    SMALL_PT,
    TEXT_PT,
    calm,
    figure,
    legend,
)
from palpate.service.report.page.page_elements import Picture, filled, picture
from palpate.storage.json_digests import to_json, to_plain
from palpate.workers.diagnosis.plan_summary import FurtherMeasurement, PlannedEffect, PlanSummary

WIDTH_IN = 10.4
CELL_IN = 0.4
# Cosines below this are harmless and not labelled.
WORTH_A_NUMBER = 0.3
DARK = 0.85

ALIKE = LinearSegmentedColormap.from_list("alike", ["#ffffff", "#f6d9ae", ORANGE, "#8a2d00"])


def alikeness_figure(plan: PlanSummary) -> Figure:
    """Return the cosines of the effects' visible parts; effects with grey names cannot be found."""
    names = [e.name for e in plan.effects]
    seen = [e.seen for e in plan.effects]
    cosines = np.array(plan.cosines)
    n = len(names)
    drawn = figure(WIDTH_IN, 2.0 + CELL_IN * n)
    axes = drawn.subplots()
    shown = np.where(np.eye(n, dtype=bool), np.nan, cosines)
    image = axes.imshow(shown, cmap=ALIKE, vmin=0.0, vmax=1.0, aspect="auto")
    for i in range(n):
        for j in range(n):
            if i != j and cosines[i, j] >= WORTH_A_NUMBER:
                axes.text(
                    j,
                    i,
                    f"{cosines[i, j]:.2f}",
                    ha="center",
                    va="center",
                    fontsize=SMALL_PT - 1.5,
                    color="white" if cosines[i, j] > DARK else INK,
                )
    labels = [spoken(name) for name in names]
    axes.set_xticks(range(n), labels, rotation=50, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(n), labels)
    for ticks in (axes.get_xticklabels(), axes.get_yticklabels()):
        for tick, ok in zip(ticks, seen, strict=True):
            tick.set(color=INK if ok else GREY, fontsize=SMALL_PT)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    bar = drawn.colorbar(image, ax=axes, shrink=0.6, pad=0.015)
    bar.set_label("cosine of the visible parts", fontsize=SMALL_PT, color=SOFT_INK)
    bar.ax.tick_params(labelsize=SMALL_PT, colors=SOFT_INK)
    bar.outline.set_visible(False)
    return drawn


def gain_figure(told_apart: int, acquisitions: Sequence[FurtherMeasurement], pairs: int) -> Figure:
    """Return the pairs distinguished now and with each further measurement, the best on top."""
    drawn = figure(WIDTH_IN, 0.9 + 0.4 * len(acquisitions))
    axes = calm(drawn.subplots(), grid="x")
    for row, acquisition in enumerate(acquisitions):
        now = min(told_apart, acquisition.told_apart)
        axes.barh(row, now, height=0.6, color=GREY)
        axes.barh(row, acquisition.told_apart - now, left=now, height=0.6, color=BLUE)
        change = round(100 * (acquisition.minimum_ratio - 1))
        said = f"; detection limit {change:+d} %".replace("-", "\u2212") if change else ""
        axes.annotate(
            f"{acquisition.told_apart}{said}",
            (acquisition.told_apart, row),
            (4, 0),
            textcoords="offset points",
            va="center",
            color=SOFT_INK,
            fontsize=SMALL_PT,
        )
    axes.set_yticks(
        range(len(acquisitions)), [a.name for a in acquisitions], fontsize=TEXT_PT, color=INK
    )
    axes.tick_params(axis="y", length=0)
    axes.set(
        ylim=(len(acquisitions) - 0.4, -0.6),
        xlim=(0, 1.25 * max([pairs / 2, *(a.told_apart for a in acquisitions)])),
        xlabel=f"pairs of effects distinguished, of {pairs}",
    )
    legend(
        axes,
        handles=[
            Patch(color=GREY, label="by the planned scans"),
            Patch(color=BLUE, label="by the further measurement"),
        ],
    )
    return drawn


@dataclass(frozen=True)
class PlannedEffectRow:
    """One effect: its parameters with detectable and plausible magnitudes."""

    name: str
    family: str
    summary: str
    parameters: tuple[tuple[str, str, str], ...]
    absorbed: str
    evidence: str
    nearest: str
    verdict: str
    seen: bool


@dataclass(frozen=True)
class GainRow:
    """A further measurement."""

    name: str
    pairs: str
    minima: str
    gain: str
    silent: str


def render_plan(plan: PlanSummary) -> str:
    """Return the page as text; equal plans give the same bytes."""
    return filled("plan.html.j2", plan_context(plan))


def plan_context(plan: PlanSummary) -> dict[str, object]:
    """Return all values of the template."""
    return {
        "name": plan.case,
        "caveats": plan.caveats or (),
        "headline": plan_headline(plan),
        "lead": _lead(plan),
        "tiles": _tiles(plan),
        "notes": [
            text
            for text in (
                silent_effects(plan),
                confused_effects(plan),
                drift_advice(plan),
                *_lost(plan),
            )
            if text
        ],
        "effects": [_effect(e) for e in plan.effects],
        "alike_picture": picture(
            alikeness_figure(plan), f"Cosines. {_alikes(plan)}.", on_paper=True
        ),
        "gain_picture": _gain_picture(plan),
        "gains": [_gain(a) for a in plan.acquisitions],
        "json": json.dumps(to_plain(to_json(plan)), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _lead(plan: PlanSummary) -> str:
    return (
        f"Predicted at {plan.points} points on the outline and on the boundary of the glandular "
        f"tissue, for a segmentation error of {plan.noise_mm:.2f} mm at each. No loaded scan was "
        "used: the model predicts the influence of every effect, and how much of it other "
        "constants would absorb."
    )


def _tiles(plan: PlanSummary) -> list[tuple[str, str, str]]:
    seen = len(plan.effects) - len(plan.silent)
    return [
        ("Effects that can be found", str(seen), f"of {len(plan.effects)}"),
        ("Pairs distinguished", str(plan.told_apart), f"of {plan.pairs}"),
        ("Points", str(plan.points), f"in {len(plan.scans)} scans"),
        ("Noise of a point", f"{plan.noise_mm:.2f}", "mm"),
    ]


def _lost(plan: PlanSummary) -> Iterator[str]:
    if plan.not_simulated:
        yield f"The model does not converge for {', '.join(plan.not_simulated)}."
    if plan.without_columns:
        yield (
            f"Left out, because they do not act here or cannot be simulated: "
            f"{together(plan.without_columns)}."
        )


def _effect(e: PlannedEffect) -> PlannedEffectRow:
    return PlannedEffectRow(
        spoken(e.name),
        e.family,
        e.summary,
        tuple(
            (parameter_name(p.parameter, p.unit), _amount(least, unit), _amount(size, unit))
            for p in e.parameters
            for least, size, unit in [p.shown]
        ),
        f"{100 * e.absorbed_share:.0f} %",
        number(e.log_evidence, 3),
        nearest_effect(e),
        WHY_NOT_FOUND[e.why_not],
        e.seen,
    )


def _gain(a: FurtherMeasurement) -> GainRow:
    return GainRow(
        a.name,
        str(a.told_apart),
        f"× {a.minimum_ratio:.2f}",
        measurement_gain(a),
        together(a.silent) if a.silent else NONE,
    )


def _gain_picture(plan: PlanSummary) -> Picture | None:
    found = plan.acquisitions
    if not found:
        return None
    said = "; ".join(f"{a.name}: {a.told_apart}" for a in found)
    return picture(gain_figure(plan.told_apart, found, plan.pairs), f"Pairs distinguished. {said}.")


def _alikes(plan: PlanSummary) -> str:
    return "; ".join(f"{spoken(e.name)}: {nearest_effect(e)}" for e in plan.effects)


def _amount(value: float | None, unit: str) -> str:
    return NONE if value is None else f"{number(value, PLAN_DIGITS)} {unit}".rstrip()
