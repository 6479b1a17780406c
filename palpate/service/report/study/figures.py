"""Figures of a study for a notebook: its scores, and sections through its bodies."""

import math
from collections.abc import Mapping
from itertools import accumulate
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from palpate.service.report.drawing.canvas import SMALL_PT, TEXT_PT, calm, figure, legend
from palpate.service.report.drawing.palette import BLUE, GREY, INK, SOFT_INK, VERMILION
from palpate.service.report.drawing.slices import AXES, VIEWS, frame_mm
from palpate.service.report.study.data import read_study_data
from palpate.service.report.study.sections import (
    DIFFERENCE_COLOURS,
    TISSUE_COLOURS,
    cut_bodies,
    difference_legend,
    middles,
    present,
)
from palpate.service.results.record import StudyResults
from palpate.storage.errors import InputError
from palpate.storage.records.best_candidate import score_of
from palpate.storage.records.record import EvaluationRecord

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
    cuts = cut_bodies(bodies, view, tissues, middles(bodies, tissues))
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
    swatches = [*present(bodies), *(difference_legend() if cuts[-1][2] else ())]
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
