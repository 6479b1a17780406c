"""The elements of a chapter of the thesis page: tables, costs, mesh sections and charts.

`book.html.j2` shows the tables and chapters. The cost of an experiment stands next to the cost
printed in the thesis. Slices of tetrahedral meshes are drawn below each other (thesis Fig. 4.14).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from palpate.service.number_formatting import count, duration, label
from palpate.service.report.drawing.colours import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PINK,
    SOFT_INK,
    TISSUE_PALETTE,
    VERMILION,
)
from palpate.service.report.drawing.matplotlib_figures import (
    SMALL_PT,
    TEXT_PT,
    calm,
    figure,
    legend,
)
from palpate.service.report.drawing.svg import Svg
from palpate.service.report.page.page_elements import Picture
from palpate.service.thesis import printed_results
from palpate.service.thesis.thesis_results import Cost, FoundSearch, Varied
from palpate.storage.values import BoolArray, FloatArray, Tissue
from palpate.workers.comparison.similarity_coefficients import HAUSDORFF_NAMES
from palpate.workers.thesis.coefficient_choice import CylinderRow, Selection
from palpate.workers.thesis.mesh_quality import BINS, MEASURES, RANGES, QualityRow

Text = str | Markup


@dataclass(frozen=True)
class Table:
    """A table that compares the thesis with Palpate.

    Parameters
    ----------
    title : str
    headings : sequence of str
    rows : sequence of sequence of str
    words : sequence of int
        Columns of text, which may wrap.
    note : str
        Text below the table.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Text]]
    words: Sequence[int] = ()
    note: str = ""


@dataclass(frozen=True)
class Chapter:
    """A chapter on one experiment.

    Parameters
    ----------
    anchor, title, where : str
        Name of the experiment, its title, its section of the thesis.
    verdict : str
        The result, in one or two sentences.
    thesis, palpate : str
        Methods of the thesis and of Palpate.
    tables, pictures : sequence
    differences : sequence of str
        Reasons for differences between the numbers.
    costs : sequence of (str, str)
    """

    anchor: str
    title: str
    where: str
    verdict: Text
    thesis: Text
    palpate: Text
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    differences: Sequence[Text] = field(default=())
    costs: Sequence[tuple[str, Text]] = ()


def cost_rows(cost: Cost | None, thesis: str) -> list[tuple[str, str]]:
    """Return the lines on a chapter's cost."""
    rows = [("the thesis", thesis)]
    if cost is not None:
        rows.append(("Palpate, processor time", duration(cost.cpu_s)))
        rows.append(("parts", f"{count(cost.parts)}, the longest {duration(cost.longest_s)}"))
        rows.append(("on", cost.machine))
    return rows


WIDTH_PX, TITLE_PX = 980.0, 24.0

MeshSlice = tuple[str, FloatArray, BoolArray]
"""A title, polygons (m, 4, 2) in mm, to the right and upwards, and a mask of glandular ones."""


def mesh_sections(shown: Sequence[MeshSlice]) -> Svg:
    """Draw slices at one scale, with all polygons of a tissue in one element."""
    places = np.concatenate([polygons.reshape(-1, 2) for _, polygons, _ in shown])
    low, high = places.min(axis=0), places.max(axis=0)
    per_mm = (WIDTH_PX - 2) / float(high[0] - low[0])
    tall = per_mm * float(high[1] - low[1]) + TITLE_PX
    drawn = Svg(WIDTH_PX, len(shown) * tall)
    for n, (title, polygons, glandular) in enumerate(shown):
        drawn.text(0, n * tall + 0.6 * TITLE_PX, title, class_="strong")
        corners = np.stack(
            [
                1 + per_mm * (polygons[..., 0] - low[0]),
                (n + 1) * tall - 1 - per_mm * (polygons[..., 1] - low[1]),
            ],
            axis=-1,
        )
        for tissue, chosen in ((Tissue.FAT, ~glandular), (Tissue.GLANDULAR, glandular)):
            drawn.add(
                "path",
                d=_outlines(corners[chosen]),
                transform="scale(0.1)",
                fill=TISSUE_PALETTE[tissue],
                stroke=INK,
                stroke_width=3,
            )
    return drawn


def _outlines(polygons: FloatArray) -> str:
    """Return polygons as a path of corner-to-corner steps in tenths of pixels."""
    tenths = np.rint(10 * polygons).astype(np.int64)
    steps = np.diff(tenths, axis=1)
    written = []
    for (x, y), moves in zip(tenths[:, 0].tolist(), steps.tolist(), strict=True):
        lines = " ".join(f"{dx} {dy}" for dx, dy in moves if dx or dy)
        if lines:
            written.append(f"M{x} {y}l{lines}z")
    return "".join(written).replace(" -", "-")


WIDTH_IN = 10.4
TARGET_LINE: Mapping[str, Any] = {"color": INK, "linewidth": 1.1, "linestyle": (0, (2, 2))}
LINES = (BLUE, ORANGE, GREEN, PINK, VERMILION, GREY)
KIND_COLOURS = dict(
    zip(
        ("homogeneous", "adaptive", "adaptive 1 mm", "adaptive 2 mm", "adaptive 3 mm"),
        LINES[:5],
        strict=True,
    )
)
# Length of a name up to which four fit in a row above a plot.
SHORT_NAME = 5
# Six plots, as the thesis divides its 28 curves; each curve of a plot has its own line style.
PLOTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("overlap and volume", ("JC", "DC", "dV")),
    ("percentiles 50, 75", HAUSDORFF_NAMES[:8]),
    ("percentile 90, maximum", HAUSDORFF_NAMES[8:16]),
    ("means", HAUSDORFF_NAMES[16:]),
    ("signed mean", ("SM",)),
    ("means and deviations", ("mean_dX", "mean_dY", "std_dX", "std_dY")),
)


def coefficient_curves(selection: Selection) -> Figure:
    """Draw the 28 normalised coefficients against the deformations of the bar (Fig. 3.5)."""
    drawn = figure(WIDTH_IN, 6.2)
    for axes, (title, names) in zip(drawn.subplots(2, 3).ravel(), PLOTS, strict=True):
        calm(axes)
        for n, name in enumerate(names):
            kept = name in selection.rejected
            style: dict[str, Any] = {"linestyle": (0, (2, 2))} if kept else {}
            bold = 2.6 if name == "D22" else 1.4
            axes.plot(
                selection.numbers,
                selection.curves[name],
                color=LINES[n % len(LINES)],
                linewidth=bold,
                marker="o",
                markersize=3,
                label=name,
                **style,
            )
        columns = 2 if max(map(len, names)) > SHORT_NAME else 4
        pad = 20 if len(names) <= columns else 34
        axes.set_title(title, fontsize=TEXT_PT, color=INK, loc="left", pad=pad)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("deformation", fontsize=SMALL_PT)
        legend(axes, ncols=columns, handlelength=1.1)
        shown = axes.get_legend()
        if shown is not None:
            shown.set_in_layout(False)  # columns keep equal widths
    return drawn


def cylinder_curves(rows: Sequence[CylinderRow]) -> Figure:
    """Draw JC, DC and GSF against the angle (Figs. 3.7 and 3.8)."""
    drawn = figure(WIDTH_IN, 3.2)
    left, right = (calm(axes, grid="both") for axes in drawn.subplots(1, 2))
    angles = [row.angle_deg for row in rows]
    left.plot(angles, [row.jc for row in rows], color=BLUE, linewidth=2, label="JC")
    left.plot(angles, [row.dc for row in rows], color=ORANGE, linewidth=2, label="DC")
    left.set(xlabel="angle, degrees", ylim=(0, 1.02))
    legend(left)
    finite = [row for row in rows if np.isfinite(row.gsf)]
    right.plot(
        [row.angle_deg for row in finite], [row.gsf for row in finite], color=BLUE, linewidth=2
    )
    right.set(xlabel="angle, degrees", ylabel="GSF; −∞ at 0 and 180")
    for axes in (left, right):
        axes.set_xticks(range(0, 181, 30))
    return drawn


def quality_bars(rows: Sequence[QualityRow]) -> Figure:
    """Draw the means of M1 to M5 for each kind of mesh (Fig. 4.15)."""
    kinds = [kind for kind in KIND_COLOURS if any(row.kind == kind for row in rows)]
    names = ("M1", "M2", "M3", "M4", "M5")
    drawn = figure(WIDTH_IN, 3.4)
    axes = calm(drawn.subplots())
    width = 0.8 / len(kinds)
    for n, kind in enumerate(kinds):
        of_kind = [row for row in rows if row.kind == kind]
        values = [[row.m5 if m == "M5" else row.mean[m] for row in of_kind] for m in names]
        means, sds = [np.mean(v) for v in values], [np.std(v) for v in values]
        positions = np.arange(len(names)) + (n - (len(kinds) - 1) / 2) * width
        axes.bar(
            positions,
            means,
            0.92 * width,
            yerr=sds,
            color=KIND_COLOURS[kind],
            label=kind,
            error_kw={"ecolor": SOFT_INK, "elinewidth": 1},
        )
    axes.set_xticks(range(len(names)), names)
    axes.set(ylim=(0, 1.02), ylabel="mean of the phantoms, 1 is best")
    legend(axes, ncols=6)
    return drawn


def quality_histograms(rows: Sequence[QualityRow]) -> Figure:
    """Draw the distribution of each measure over the tetrahedra of all phantoms."""
    drawn = figure(WIDTH_IN, 2.6)
    kinds = [k for k in ("adaptive", "homogeneous") if any(r.kind == k for r in rows)]
    for axes, name in zip(drawn.subplots(1, len(MEASURES)), MEASURES, strict=True):
        calm(axes, grid="")
        low, high = RANGES[name]
        edges = np.linspace(low, high, BINS + 1)
        for kind in kinds:
            counts = np.sum([row.histograms[name] for row in rows if row.kind == kind], axis=0)
            share = counts / counts.sum()
            axes.stairs(share, edges, color=KIND_COLOURS[kind], linewidth=1.6, label=kind)
        axes.set(yticks=[], xlabel="aspect ratio" if name == "aspect" else name)
        axes.set_xlim((1, 5) if name == "aspect" else (0, 1))
    handles, labels = drawn.axes[0].get_legend_handles_labels()
    drawn.legend(
        handles,
        labels,
        frameon=False,
        fontsize=SMALL_PT,
        labelcolor=SOFT_INK,
        loc="outside upper left",
        ncols=3,
    )
    return drawn


def pictures_in_a_row(shown: Sequence[tuple[str, NDArray[Any]]], *, labels: bool = False) -> Figure:
    """Draw grey or coloured pictures in a row."""
    rows, columns = shown[0][1].shape[:2]
    height = min(5.0, 0.3 + WIDTH_IN / len(shown) * rows / columns)
    drawn = figure(WIDTH_IN, height)
    made = drawn.subplots(1, len(shown), squeeze=False)[0]
    for axes, (title, values) in zip(made, shown, strict=True):
        kind: dict[str, Any] = {} if labels else {"cmap": "gray", "vmin": 0, "vmax": 255}
        axes.imshow(values, interpolation="nearest", **kind)
        axes.set_title(title, fontsize=SMALL_PT, color=INK, loc="left")
        axes.axis("off")
    return drawn


def error_chart(found: Sequence[FoundSearch], table: printed_results.SearchTable) -> Figure:
    """Draw the relative errors of each constant: thesis, Palpate, and before the refinement."""
    names = [c.name for c in found[0].constants]
    drawn = figure(WIDTH_IN, 0.75 + 0.55 * len(names))
    axes = calm(drawn.subplots(), grid="x")
    targets = [c.target for c in found[0].constants]
    for row, target in enumerate(targets):
        theirs = [max(abs(r.constants_kpa[row] / target - 1), 1e-4) for r in table.rows]
        ours = [max(s.constants[row].error, 1e-4) for s in found]
        before = [s.constants[row].genetic_error for s in found]
        axes.plot(theirs, [row - 0.2] * len(theirs), "D", color=GREY, markersize=5, alpha=0.9)
        known = [max(b, 1e-4) for b in before if b is not None]
        axes.plot(known, [row] * len(known), "s", color=ORANGE, markersize=5, alpha=0.9)
        axes.plot(ours, [row + 0.2] * len(ours), "o", color=BLUE, markersize=6, alpha=0.9)
    axes.set_xscale("log")
    axes.set_xlim(8e-5, 1.2)
    axes.set_xticks([1e-4, 1e-3, 1e-2, 1e-1, 1], ["≤ 0.01 %", "0.1 %", "1 %", "10 %", "100 %"])
    axes.set_yticks(range(len(names)), [label(n, "") for n in names], fontsize=TEXT_PT, color=INK)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel("relative error of one phantom")
    for marker, colour, text in _error_marks(found):
        axes.plot([], [], marker, color=colour, label=text)
    legend(axes)
    return drawn


def _error_marks(found: Sequence[FoundSearch]) -> list[tuple[str, str, str]]:
    marks = [("D", GREY, "thesis"), ("o", BLUE, "Palpate")]
    if any(c.genetic_error is not None for s in found for c in s.constants):
        marks.insert(1, ("s", ORANGE, "Palpate, genetic stage alone"))
    return marks


def sensitivity_curves(varied: Sequence[Varied]) -> Figure:
    """Draw JC and MHD against each constant (Fig. 4.22 shows eta_glandular)."""
    drawn = figure(WIDTH_IN, 4.2)
    grid: NDArray[Any] = drawn.subplots(2, len(varied), sharey="row", squeeze=False)
    for column, variation in enumerate(varied):
        name = variation.constant.removesuffix("_kpa")
        _curve(grid[0, column], variation, variation.jc, BLUE)
        _curve(grid[1, column], variation, variation.mhd_voxels, VERMILION)
        grid[0, column].set_title(label(name, ""), fontsize=TEXT_PT, color=INK, loc="left")
        grid[1, column].set_xlabel("kPa", fontsize=SMALL_PT)
    grid[0, 0].set_ylabel("JC")
    grid[1, 0].set_ylabel("MHD, voxels")
    return drawn


def _curve(axes: Axes, one: Varied, values: Sequence[float | None], colour: str) -> None:
    calm(axes, grid="both")
    known = [(x, y) for x, y in zip(one.values_kpa, values, strict=True) if y is not None]
    axes.plot(
        [x for x, _ in known], [y for _, y in known], color=colour, marker="o", markersize=3.5
    )
    axes.axvline(one.at_target, **TARGET_LINE)
    axes.xaxis.set_major_locator(MaxNLocator(4))
