"""Draw how the 90 % intervals of simulated studies lie about the truth.

::

    python -m tests.benchmarks.interval_coverage OUT --seeds 6 7 8 9 10
    python docs/pictures/draw_coverage.py OUT/coverage.json docs/pictures/coverage.png
"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

BLUE, GREY = "#0072b2", "#b0b6c0"


def draw(coverage: Path, out: Path) -> None:
    """Draw every interval over its true value, a column for each kind of study."""
    rows = [row for row in json.loads(coverage.read_text()) if row["lower"] is not None]
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    figure, axes = plt.subplots(figsize=(8.4, 4.2), layout="constrained")
    for column, kind in enumerate(kinds):
        here = [row for row in rows if row["kind"] == kind]
        for place, row in zip(np.linspace(-0.36, 0.36, len(here)), here, strict=True):
            colour = BLUE if row["quotable"] else GREY
            ends = [row["lower"] / row["truth"], row["upper"] / row["truth"]]
            axes.plot([column + place] * 2, ends, color=colour, lw=1.4)
            axes.plot(column + place, row["estimate"] / row["truth"], ".", color=colour, ms=4)
    axes.axhline(1.0, color="#333333", lw=0.8)
    axes.set_yscale("log")
    axes.set_ylim(0.1, 10)
    axes.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    axes.set_xticks(range(len(kinds)), kinds, rotation=35, ha="right")
    axes.set_ylabel("estimate and interval / truth")
    axes.plot([], [], color=BLUE, label="quotable")
    axes.plot([], [], color=GREY, label="not quotable")
    axes.legend(frameon=False, loc="upper right", ncols=2)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(out, dpi=120)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
