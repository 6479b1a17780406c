"""Figures of a diagnosis for a notebook: the gap, and the distribution of residuals."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.service.diagnosis.run import FinishedDiagnosis
from palpate.service.diagnosis.words import together
from palpate.service.report.diagnosis.charts import gap_rows
from palpate.service.report.drawing.canvas import TEXT_PT, calm, figure, legend
from palpate.service.report.drawing.palette import BLUE, GREY, INK
from palpate.storage.stores.arrays import Arrays
from palpate.workers.diagnosis.schema.summary import GapEstimate, Summary

BAR = 0.34
BINS = 41
# Residuals beyond this quantile are not shown.
MOST = 0.995
NOISE = "noise of one point"


def gap_figure(diagnosis: FinishedDiagnosis) -> Figure:
    """Draw the gap with and without the cause, next to the residuals."""
    summary = diagnosis.summary
    rows = len(gap_rows(summary))
    drawn = figure(9.2, max(3.0, 1.6 + 0.62 * rows))
    left, right = drawn.subplots(1, 2)
    cause = f"with {together(summary.primary)}" if summary.primary else ""
    _bars(left, summary, cause)
    _residuals(right, diagnosis.maps, summary, cause)
    return drawn


def _bars(axes: Axes, summary: Summary, cause: str) -> None:
    calm(axes, grid="x")
    rows = gap_rows(summary)
    two = any(row.after is not None for row in rows)
    for number, row in enumerate(rows):
        _bar(axes, row.before, number - BAR / 2 * two, GREY, "" if number else "nominal model")
        if row.after is not None:
            _bar(axes, row.after, number + BAR / 2, BLUE, "" if number else cause)
    floor = summary.gap_mm.noise_floor
    axes.axvline(floor, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label=NOISE)
    axes.set_yticks(range(len(rows)), [_wrapped(row.title) for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("gap beyond the noise, mm")
    legend(axes, ncols=1)


def _bar(axes: Axes, gap: GapEstimate, y: float, colour: str, label: str) -> None:
    axes.barh(y, gap.gap_mm, BAR, color=colour, label=label or None)
    axes.plot([gap.low_mm, gap.high_mm], [y, y], color=INK, linewidth=1.3, solid_capstyle="butt")


def _residuals(axes: Axes, maps: Arrays, summary: Summary, cause: str) -> None:
    calm(axes, grid="x")
    shown = [("before", GREY, "nominal model"), ("after", BLUE, cause)]
    known = [(np.ravel(maps[key]), colour, name) for key, colour, name in shown if key in maps]
    known = [(values[np.isfinite(values)], colour, name) for values, colour, name in known]
    most = max(float(np.quantile(np.abs(values), MOST)) for values, _, _ in known) or 1.0
    edges = np.linspace(-most, most, BINS)
    for values, colour, name in known:
        axes.stairs(np.histogram(values, edges)[0], edges, color=colour, linewidth=1.5, label=name)
    floor = summary.gap_mm.noise_floor
    for end in (-floor, floor):
        axes.axvline(end, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("residual of a point, mm")
    axes.set_title(f"{len(known[0][0]):,} residuals", fontsize=TEXT_PT, color=INK, loc="left")


def _wrapped(title: str) -> str:
    return title.replace(", ", ",\n", 1)
