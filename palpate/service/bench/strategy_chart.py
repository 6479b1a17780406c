"""Chart of the convergence of strategies: score and error against evaluations and seconds."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from palpate.service.bench.strategies import NEAR, Improvement, Reached
from palpate.service.report.drawing.canvas import TEXT_PT, calm, figure, svg
from palpate.service.report.drawing.palette import BLUE, GREEN, INK, ORANGE, PINK
from palpate.storage.backends.atomic import write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 10.4, 6.4
COLOURS = {
    "least-squares": BLUE,
    "genetic+least-squares": GREEN,
    "genetic": ORANGE,
    "cma": PINK,
}
# Smaller errors are due to rounding and to the voxels.
LEAST_ERROR = 1e-5


def write_chart(rows: Sequence[Reached], path: Path) -> None:
    """Write the chart to a separate file, on a white background."""
    write_file(path, svg(strategy_chart(rows)).encode())


def strategy_chart(rows: Sequence[Reached]) -> "Figure":
    """Draw each study as a thin line and each strategy's median as a thick one."""
    drawn = figure(WIDTH_IN, HEIGHT_IN)
    drawn.set_facecolor("white")
    grid = drawn.subplots(2, 2, sharex="col", sharey="row", squeeze=False)
    for strategy, colour in COLOURS.items():
        own = [row.improvements for row in rows if row.strategy == strategy and row.improvements]
        if not own:
            continue
        for column, over in enumerate(("evaluations", "core_s")):
            for line, value in enumerate(("gsf", "error")):
                _curves(grid[line, column], own, over, value, colour, strategy)
    titles = ("evaluations", "CPU seconds of one core")
    for column, title in enumerate(titles):
        grid[1, column].set_xlabel(title, fontsize=TEXT_PT)
        for axes in grid[:, column]:
            calm(axes, grid="both")
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
        grid[1, column].set_yscale("log")
        grid[1, column].axhline(NEAR, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    grid[0, 0].set_ylabel("GSF of the best candidate", fontsize=TEXT_PT)
    grid[1, 0].set_ylabel("larger error of the Young's moduli", fontsize=TEXT_PT)
    shares = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
    grid[1, 0].set_yticks(shares, ["0.01 %", "0.1 %", "1 %", "10 %", "100 %"])
    handles, labels = grid[0, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, frameon=False, loc="outside upper left", ncols=4)
    return drawn


def _curves(
    axes: "Axes",
    studies: Sequence[Sequence[Improvement]],
    over: str,
    value: str,
    colour: str,
    title: str,
) -> None:
    """Draw one strategy; a study keeps its last value after its end."""
    curves = []
    for improvements in studies:
        x = np.array([getattr(one, over) for one in improvements])
        y = np.array([max(getattr(one, value), LEAST_ERROR if value == "error" else -np.inf)
                      for one in improvements])  # fmt: skip
        axes.step(x, y, where="post", color=colour, linewidth=0.6, alpha=0.4)
        curves.append((x, y))
    # The median starts where every study has a candidate.
    first = max(x[0] for x, _ in curves)
    places = np.unique(np.concatenate([x for x, _ in curves] + [np.array([first])]))
    places = places[places >= first]
    held = [y[np.searchsorted(x, places, side="right") - 1] for x, y in curves]
    middle = np.median(held, axis=0)
    axes.step(places, middle, where="post", color=colour, linewidth=2.2, label=title)
