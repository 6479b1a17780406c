"""Draw the block of the bench tutorial at rest and under its load.

::

    python docs/pictures/draw_block.py docs/pictures/block.png
"""

import sys
from itertools import product
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "bench"))

from record import MARKERS, SIZE_MM, stretches

BLUE, GREY = "#0072b2", "#888888"


def _edges(size: np.ndarray) -> list[np.ndarray]:
    """Return the twelve edges of a box as pairs of points."""
    corners = [np.array(c) * size for c in product((0, 1), repeat=3)]
    return [
        np.stack([a, b])
        for i, a in enumerate(corners)
        for b in corners[i + 1 :]
        if np.count_nonzero(a != b) == 1
    ]


def main(out: Path) -> None:
    """Write the picture."""
    side, axial = stretches()
    scale = np.array([side, side, axial])
    figure = plt.figure(figsize=(6, 4.2), layout="constrained")
    places = np.array(list(MARKERS.values()))
    for number, (title, factor) in enumerate((("at rest", np.ones(3)), ("under 18 N", scale)), 1):
        axes = figure.add_subplot(1, 2, number, projection="3d")
        for edge in _edges(SIZE_MM):
            axes.plot(*edge.T, color=GREY, lw=0.7, ls=":")
        for edge in _edges(SIZE_MM * factor):
            axes.plot(*edge.T, color=BLUE, lw=1.2)
        axes.scatter(*(places * factor).T, color="#c44e00", s=22, depthshade=False)
        for name, place in zip(MARKERS, places * factor, strict=True):
            axes.text(*(place + 1.5), name, fontsize=8)
        axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)", zlim=(0, 70))
        axes.set_box_aspect((30, 30, 70))
        axes.view_init(18, 35)
    figure.savefig(out, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
