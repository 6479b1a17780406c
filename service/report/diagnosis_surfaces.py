"""Where model and scan differ, on the surfaces of the body at rest, in three dimensions.

Triangles are projected along parallel lines, drawn from the farthest to the nearest
and shaded by a lamp at the viewer's left shoulder. A triangle has the colour of the
nearest point of its interface.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colors import Normalize, to_rgb, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray
from scipy.spatial import KDTree

from service.report.canvas import SMALL_PT, TEXT_PT, figure
from service.report.diagnosis_maps import FAINT, SIGNED, SIGNIFICANT, sharpened
from service.report.palette import INK, SOFT_INK
from storage.values import FloatArray, IntArray

WIDTH_IN = 10.4
# A triangle farther from every point has no colour: the rim at the chest wall, thin strands.
FARTHEST_MM = 9.0
UNKNOWN = "#f1f2f4"
# Opposite corners of the body, both from the side of the nipple.
SIDES = (
    ("seen from +x, +y", np.array([0.45, 0.70, 0.55])),
    ("seen from −x, −y", np.array([-0.45, -0.70, 0.55])),
)
# How much of the light comes from everywhere.
AMBIENT = 0.72
# Steps of the light, and edges without half tones, make an image a third as heavy.
STEPS = 16
# Length of the drawn axes, as a share of the longest side of the body.
AXIS = 0.12


@dataclass(frozen=True, eq=False)
class Painted:
    """One interface with the residuals at its points.

    Parameters
    ----------
    name : str
    vertices : ndarray, shape (n, 3)
        In mm.
    triangles : ndarray of int, shape (m, 3)
        Counter-clockwise seen from outside.
    points : ndarray, shape (k, 3)
        In mm.
    rows : mapping of str to (ndarray, ndarray), each of shape (k,)
        Residuals and their standard deviations in mm by the title of their row; the same
        titles for all interfaces.
    """

    name: str
    vertices: FloatArray
    triangles: IntArray
    points: FloatArray
    rows: Mapping[str, tuple[FloatArray, FloatArray]]


def surface_map(painted: Sequence[Painted], most_mm: float) -> Figure:
    """Return every interface from two sides, a row for each kind of residual.

    Parameters
    ----------
    painted : sequence of Painted
    most_mm : float
        End of the colour scale.
    """
    panels = [(one, side, basis(way)) for one in painted for side, way in SIDES]
    spans = [_span(one.vertices, across, up) for one, _, (across, up, _) in panels]
    widths = [span[0] for span in spans]
    height = max(span[1] for span in spans) * (WIDTH_IN - 1.1) / sum(widths)
    titles = list(painted[0].rows)
    drawn = figure(WIDTH_IN, len(titles) * (height + 0.5) + 0.3)
    sharpened(drawn)
    grid = drawn.subplots(len(titles), len(panels), squeeze=False, width_ratios=widths)
    scale = Normalize(-most_mm, most_mm)
    for line, title in zip(grid, titles, strict=True):
        for axes, (one, side, axes_of_view) in zip(line, panels, strict=True):
            colours = colours_of(one, *one.rows[title], scale)
            _solid(axes, one.vertices, one.triangles, colours, axes_of_view)
            axes.set_xlabel(f"{one.name}\n{side}", fontsize=SMALL_PT, color=SOFT_INK)
            if one is painted[0]:
                _triad(axes, one.vertices, axes_of_view)
        line[0].set_title(title, fontsize=TEXT_PT, color=INK, loc="left")
    bar = drawn.colorbar(
        ScalarMappable(scale, SIGNED), ax=grid, aspect=30, pad=0.01, extend="both", panchor=False
    )
    bar.set_label("model outside (+) or inside (−), mm", fontsize=SMALL_PT, color=INK)
    bar.ax.tick_params(labelsize=SMALL_PT, colors=SOFT_INK)
    bar.outline.set_visible(False)
    return drawn


def basis(towards_viewer: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors to the right, up and to the viewer; the nipple points upwards."""
    near = towards_viewer / np.linalg.norm(towards_viewer)
    across = np.cross([0.0, 0.0, 1.0], near)
    across /= np.linalg.norm(across)
    return across, np.cross(near, across), near


def colours_of(
    one: Painted, residual: FloatArray, noise: FloatArray, scale: Normalize
) -> FloatArray:
    """Colour of each triangle before it is shaded, shape (m, 3).

    Grey where the nearest point lies within the noise, paler still where none is near.
    """
    centres = one.vertices[one.triangles].mean(axis=1)
    away, nearest = KDTree(one.points).query(centres)
    colours: FloatArray = np.asarray(SIGNED(scale(residual[nearest])))[:, :3]
    colours[np.abs(residual[nearest]) < SIGNIFICANT * noise[nearest]] = to_rgb(FAINT)
    colours[away > FARTHEST_MM] = to_rgb(UNKNOWN)
    return colours


def _solid(
    axes: Axes,
    vertices: FloatArray,
    triangles: IntArray,
    colours: FloatArray,
    axes_of_view: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Draw the triangles, the nearest last."""
    across, up, near = axes_of_view
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    lamp = near + 0.5 * up - 0.5 * across
    light = np.rint(STEPS * np.abs(normals @ (lamp / np.linalg.norm(lamp)))) / STEPS
    shaded = colours * (AMBIENT + (1 - AMBIENT) * light)[:, None]
    order = np.argsort((corners @ near).mean(axis=1), kind="stable")
    flat = np.stack([corners @ across, corners @ up], axis=-1)
    axes.add_collection(_flat_triangles(flat[order], shaded[order]), autolim=False)
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    axes.set(
        xlim=(low[0] - 2, high[0] + 2), ylim=(low[1] - 2, high[1] + 2), aspect="equal", anchor="S"
    )
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def _flat_triangles(corners: FloatArray, colours: FloatArray) -> TriMesh:
    """Return triangles (m, 3, 2) of one colour each; many times faster drawn than as polygons."""
    x, y = corners.reshape(-1, 2).T
    alone = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    drawn = TriMesh(alone, rasterized=True)
    drawn.set_facecolor(to_rgba_array(np.repeat(colours, 3, axis=0)))  # type: ignore[arg-type]
    return drawn


def _span(vertices: FloatArray, across: FloatArray, up: FloatArray) -> NDArray[np.float64]:
    return np.array([np.ptp(vertices @ across), np.ptp(vertices @ up)]) + 4.0


def _triad(
    axes: Axes, vertices: FloatArray, axes_of_view: tuple[FloatArray, FloatArray, FloatArray]
) -> None:
    """Return the three axes of space, in the corner that a long body leaves."""
    across, up, _ = axes_of_view
    length = AXIS * float(np.ptp(vertices, axis=0).max())
    directions = length * np.stack([np.eye(3) @ across, np.eye(3) @ up], axis=1)
    reach = 1.4 * np.abs(directions).max(axis=0)
    start = np.array([(vertices @ across).max() - reach[0], (vertices @ up).min() + reach[1] / 2])
    arrow = {"arrowstyle": "->", "color": SOFT_INK, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    for name, direction in zip("xyz", directions, strict=True):
        axes.annotate("", tuple(start + direction), tuple(start), arrowprops=arrow)
        x, y = start + 1.3 * direction
        axes.text(x, y, name, fontsize=SMALL_PT, color=SOFT_INK, ha="center", va="center")
