"""Charts of a plan: similarity of effects, and benefits of further measurements."""

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from palpate.service.diagnosis.words import spoken
from palpate.service.report.drawing.canvas import SMALL_PT, TEXT_PT, calm, figure, legend
from palpate.service.report.drawing.palette import BLUE, GREY, INK, ORANGE, SOFT_INK
from palpate.workers.diagnosis.schema.plan import FurtherMeasurement, PlanSummary

WIDTH_IN = 10.4
CELL_IN = 0.4
# Cosines below this are harmless and not labelled.
WORTH_A_NUMBER = 0.3
DARK = 0.85

ALIKE = LinearSegmentedColormap.from_list("alike", ["#ffffff", "#f6d9ae", ORANGE, "#8a2d00"])


def alikeness(plan: PlanSummary) -> Figure:
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


def gains(told_apart: int, acquisitions: Sequence[FurtherMeasurement], pairs: int) -> Figure:
    """Return the pairs distinguished now and with each further measurement, the best on top."""
    drawn = figure(WIDTH_IN, 0.9 + 0.4 * len(acquisitions))
    axes = calm(drawn.subplots(), grid="x")
    for number, one in enumerate(acquisitions):
        now = min(told_apart, one.told_apart)
        axes.barh(number, now, height=0.6, color=GREY)
        axes.barh(number, one.told_apart - now, left=now, height=0.6, color=BLUE)
        change = round(100 * (one.minimum_ratio - 1))
        said = f"; detection limit {change:+d} %".replace("-", "\u2212") if change else ""
        axes.annotate(
            f"{one.told_apart}{said}",
            (one.told_apart, number),
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
