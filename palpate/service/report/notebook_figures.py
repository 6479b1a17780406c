"""Figures for a notebook, drawn by matplotlib.

Of a study: its scores, and sections through its bodies. Of a diagnosis: the gap, and the
distribution of residuals.
"""

import math
from collections.abc import Mapping
from itertools import accumulate
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.service.diagnosis.diagnosis_words import together
from palpate.service.report.diagnosis.diagnosis_charts import gap_rows
from palpate.service.report.drawing.colours import BLUE, GREY, INK, SOFT_INK, VERMILION
from palpate.service.report.drawing.matplotlib_figures import (
    SMALL_PT,
    TEXT_PT,
    calm,
    figure,
    legend,
)
from palpate.service.report.drawing.volume_sections import AXES, VIEWS, frame_mm
from palpate.service.report.study.study_data import read_study_data
from palpate.service.report.study.study_sections import (
    DIFFERENCE_COLOURS,
    TISSUE_COLOURS,
    cut_bodies,
    difference_legend,
    section_middles,
    tissue_legend,
)
from palpate.service.results.result_records import StudyResults
from palpate.storage.best_candidate import score_of
from palpate.storage.errors import InputError
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.stored_arrays import Arrays
from palpate.workers.diagnosis.outcome.diagnosis_summary import GapEstimate, Summary

PANEL_IN = 2.6
# Font size of titles, ticks and the legend.
AROUND_IN = 1.5


def convergence_figure(results: StudyResults, endings: Mapping[int, EvaluationRecord]) -> Figure:
    """Draw the minimised score of every evaluation and the best one so far.

    Raises
    ------
    InputError
        If no evaluation has a score.
    """
    scores = np.array([score_of(record) for _, record in sorted(endings.items())])
    finite = np.isfinite(scores)
    if not finite.any():
        raise InputError(f"No evaluation of {results.name} has a score yet.")
    drawn = figure(6.4, 3.4)
    axes = calm(drawn.subplots())
    number = np.arange(1, len(scores) + 1)
    axes.plot(number[finite], scores[finite], ".", color=GREY, label="evaluation")
    lowest = np.array(list(accumulate(scores, min)))
    shown = np.where(np.isfinite(lowest), lowest, math.nan)
    axes.step(number, shown, where="post", color=BLUE, linewidth=1.8, label="lowest so far")
    failed = number[scores == np.inf]
    if len(failed):
        top = np.full(len(failed), 1.0)
        axes.plot(
            failed,
            top,
            "x",
            color=VERMILION,
            transform=axes.get_xaxis_transform(),
            clip_on=False,
            label="failed",
        )
    axes.set(xlabel="evaluation", ylabel=f"{results.spec.objective.axis}, lower is better")
    legend(axes)
    return drawn


def slices_figure(folder: Path, view_name: str) -> Figure:
    """Draw undeformed body, target, best candidate and their difference in one plane.

    Raises
    ------
    InputError
        If the view is unknown, or the store has none of the volumes.
    """
    views = {view.name: view for view in VIEWS}
    if view_name not in views:
        raise InputError(f"view = {view_name!r}: expected one of {', '.join(views)}.")
    data = read_study_data(folder, quick=True)
    bodies, view = data.bodies, views[view_name]
    tissues = [n for n, name in bodies.labels.items() if name in data.results.spec.score.parts]
    cuts = cut_bodies(bodies, view, tissues, section_middles(bodies, tissues))
    if not cuts:
        raise InputError(f"There are no volumes to show. {' '.join(bodies.missing)}")
    left, right, bottom, top = frame_mm([cut for _, cut, _ in cuts])
    drawn = figure(PANEL_IN * len(cuts), PANEL_IN * (top - bottom) / (right - left) + AROUND_IN)
    row = drawn.subplots(1, len(cuts), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, cut, differs) in zip(row, cuts, strict=True):
        calm(axes, grid="")
        colours = DIFFERENCE_COLOURS if differs else TISSUE_COLOURS
        axes.imshow(colours[cut.values], origin="lower", extent=cut.extent_mm)
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel=f"{AXES[view.across]}, mm")
        axes.set_title(title, fontsize=TEXT_PT, color=INK)
    row[0].set_ylabel(f"{AXES[view.up]}, mm")
    swatches = [*tissue_legend(bodies), *(difference_legend() if cuts[-1][2] else ())]
    drawn.legend(
        [Patch(facecolor=colour, edgecolor=GREY, linewidth=0.5) for colour, _ in swatches],
        [text for _, text in swatches],
        loc="outside lower center",
        ncols=min(4, len(swatches)),
        frameon=False,
        fontsize=SMALL_PT,
        labelcolor=SOFT_INK,
    )
    return drawn


BAR_HEIGHT = 0.34
RESIDUAL_BINS = 41
# Residuals beyond this quantile are not shown.
SHOWN_SHARE = 0.995
NOISE_LABEL = "noise of one point"


def gap_figure(diagnosis: FinishedDiagnosis) -> Figure:
    """Draw the gap with and without the cause, next to the residuals."""
    summary = diagnosis.summary
    rows = len(gap_rows(summary))
    drawn = figure(9.2, max(3.0, 1.6 + 0.62 * rows))
    left, right = drawn.subplots(1, 2)
    cause = f"with {together(summary.primary)}" if summary.primary else ""
    _gap_bars(left, summary, cause)
    _residual_histogram(right, diagnosis.maps, summary, cause)
    return drawn


def _gap_bars(axes: Axes, summary: Summary, cause: str) -> None:
    calm(axes, grid="x")
    rows = gap_rows(summary)
    two = any(row.after is not None for row in rows)
    for number, row in enumerate(rows):
        _gap_bar(
            axes, row.before, number - BAR_HEIGHT / 2 * two, GREY, "" if number else "nominal model"
        )
        if row.after is not None:
            _gap_bar(axes, row.after, number + BAR_HEIGHT / 2, BLUE, "" if number else cause)
    floor = summary.gap_mm.noise_floor
    axes.axvline(floor, color=INK, linewidth=1.0, linestyle=(0, (2, 2)), label=NOISE_LABEL)
    axes.set_yticks(range(len(rows)), [_wrapped_title(row.title) for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("gap beyond the noise, mm")
    legend(axes, ncols=1)


def _gap_bar(axes: Axes, gap: GapEstimate, y: float, colour: str, label: str) -> None:
    axes.barh(y, gap.gap_mm, BAR_HEIGHT, color=colour, label=label or None)
    axes.plot([gap.low_mm, gap.high_mm], [y, y], color=INK, linewidth=1.3, solid_capstyle="butt")


def _residual_histogram(axes: Axes, maps: Arrays, summary: Summary, cause: str) -> None:
    calm(axes, grid="x")
    shown = [("before", GREY, "nominal model"), ("after", BLUE, cause)]
    known = [(np.ravel(maps[key]), colour, name) for key, colour, name in shown if key in maps]
    known = [(values[np.isfinite(values)], colour, name) for values, colour, name in known]
    most = max(float(np.quantile(np.abs(values), SHOWN_SHARE)) for values, _, _ in known) or 1.0
    edges = np.linspace(-most, most, RESIDUAL_BINS)
    for values, colour, name in known:
        axes.stairs(np.histogram(values, edges)[0], edges, color=colour, linewidth=1.5, label=name)
    floor = summary.gap_mm.noise_floor
    for end in (-floor, floor):
        axes.axvline(end, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("residual of a point, mm")
    axes.set_title(f"{len(known[0][0]):,} residuals", fontsize=TEXT_PT, color=INK, loc="left")


def _wrapped_title(title: str) -> str:
    return title.replace(", ", ",\n", 1)
