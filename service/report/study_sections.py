"""Draws reference, target, best candidate and difference side by side along one axis."""

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from service.report import palette
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure
from service.report.palette import INK, Difference
from service.report.slices import (
    AXES,
    Section,
    View,
    difference,
    frame_mm,
    middle_mm,
    section,
)
from service.report.study_bodies import Bodies
from storage.values import Tissue, Triple

# At most so wide and high; bodies that are wide are drawn larger, two in a row.
WIDE_IN, HIGH_IN = (4.75, 2.9), (2.3, 2.9)
WIDE = 1.4
_TISSUES = palette.lookup(palette.TISSUES)
_DIFFERENCES = palette.lookup(palette.DIFFERENCES)


def side_by_side(bodies: Bodies, view: View, tissues: Sequence[int]) -> Figure | None:
    """Draw one view of all bodies that are there; None if there is none.

    The planes pass through the middle of `tissues`: of the target for target and best
    candidate, so that both are cut in the same place, and of the undeformed body for
    itself.
    """
    shown = _sections(bodies, view, tissues)
    if not shown:
        return None
    left, right, bottom, top = frame_mm([s for _, s, _ in shown])
    wide = right - left > WIDE * (top - bottom)
    most, columns = (WIDE_IN, 2) if wide else (HIGH_IN, 4)
    columns = min(columns, len(shown))
    rows = math.ceil(len(shown) / columns)
    per_mm = min(most[0] / (right - left), most[1] / (top - bottom))
    width, height = per_mm * (right - left), per_mm * (top - bottom)
    drawn = figure(columns * (width + 0.18) + 0.62, rows * (height + 0.36) + 0.5)
    grid = drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (title, cut, is_difference) in zip(grid.flat, shown, strict=False):
        table = _DIFFERENCES if is_difference else _TISSUES
        axes.imshow(table[cut.values], origin="lower", extent=cut.extent_mm, interpolation="none")
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.set_title(title, fontsize=TEXT_PT, color=INK, loc="left", pad=6)
        _frame(axes)
    for axes in grid.flat[len(shown) :]:
        axes.axis("off")
    for axes in grid[:, 0]:
        axes.set_ylabel(f"{AXES[view.up]}, mm", fontsize=SMALL_PT)
    for axes in grid[-1]:
        axes.set_xlabel(f"{AXES[view.across]}, mm", fontsize=SMALL_PT)
    return drawn


def middles(bodies: Bodies, tissues: Sequence[int]) -> tuple[Triple | None, Triple | None]:
    """Return where the undeformed body and the target are cut."""
    first = None if bodies.reference is None else middle_mm(bodies.reference, tissues)
    explained = bodies.target if bodies.target is not None else bodies.best
    return first, None if explained is None else middle_mm(explained, tissues)


def present(bodies: Bodies) -> list[tuple[str, str]]:
    """Return (colour, name) of every tissue that a legend needs."""
    volumes = [v for v in (bodies.reference, bodies.target, bodies.best) if v is not None]
    there = [t for t in bodies.labels if any((v.values == t).any() for v in volumes)]
    return [(palette.TISSUES[Tissue(t)], bodies.labels[t]) for t in there]


def difference_legend() -> list[tuple[str, str]]:
    """Return (colour, meaning) of the colours of a difference."""
    meaning = {
        Difference.BOTH: "in both",
        Difference.ONLY_TARGET: "only in the target",
        Difference.ONLY_BEST: "only in the best candidate",
        Difference.BODY: "rest of the body",
    }
    return [(palette.DIFFERENCES[kind], text) for kind, text in meaning.items()]


def _sections(
    bodies: Bodies, view: View, tissues: Sequence[int]
) -> list[tuple[str, Section, bool]]:
    undeformed, deformed = middles(bodies, tissues)
    shown = []
    cuts: dict[str, Section] = {}
    for title, volume, middle in (
        ("Undeformed", bodies.reference, undeformed),
        ("Target", bodies.target, deformed),
        ("Best candidate", bodies.best, deformed),
    ):
        if volume is not None and middle is not None:
            cuts[title] = section(volume, view, middle[view.normal])
            shown.append((title, cuts[title], False))
    if "Target" in cuts and "Best candidate" in cuts:
        names = " + ".join(bodies.labels[t] for t in tissues)
        compared = difference(cuts["Target"], cuts["Best candidate"], tissues)
        shown.append((f"Difference, {names}", compared, True))
    return shown


def _frame(axes: Axes) -> None:
    calm(axes, grid="")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
