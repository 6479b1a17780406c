"""The gap on the surfaces of the body at rest, in three dimensions.

Triangles are projected orthographically with a depth buffer, and shaded by a light at the
viewer's upper left. A triangle has the colour of the nearest point of its interface. All scans
and models share the same views, so the visible triangle at each pixel is computed once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from palpate.service.report.diagnosis.maps import BAR_LABEL, FAINT, SIGNIFICANT
from palpate.service.report.drawing.colour_scale import SIGNED, ColourScale, colour_bar
from palpate.service.report.drawing.palette import to_rgba
from palpate.service.report.drawing.panel import Frame, Panel
from palpate.service.report.drawing.raster import image_uri
from palpate.service.report.drawing.svg import Svg
from palpate.service.report.drawing.triangle_raster import front_triangles
from palpate.storage.values import BoolArray, FloatArray, IntArray

WIDTH_PX = 998.0
# Triangles farther from every point have no colour: the rim at the chest wall, thin strands.
FARTHEST_MM = 9.0
UNKNOWN = "#f1f2f4"
# Opposite corners of the body, both from the side of the nipple.
SIDES = (
    ("seen from +x, +y", np.array([0.45, 0.70, 0.55])),
    ("seen from −x, −y", np.array([-0.45, -0.70, 0.55])),
)
MARGIN_MM = 2.0
BAR_PX, BETWEEN_PX, HEAD_PX, WORDS_PX = 90.0, 6.0, 24.0, 40.0
# Image pixels per page pixel, for high-resolution screens.
DOTS = 1.875
# Fraction of ambient light.
AMBIENT = 0.72
# Quantised light, and edges without antialiasing, make an image a third of the size.
STEPS = 16
# Length of the drawn axes, relative to the longest side of the body.
AXIS = 0.12
ARROW_PX = 5.0

# Unit vectors to the right, up and to the viewer.
View = tuple[FloatArray, FloatArray, FloatArray]
# (residuals, their standard deviations) in mm at the points of a solid, by the title of the row
# and the name of the solid.
Residuals = Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]]


@dataclass(frozen=True, eq=False)
class Solid:
    """One interface and the points with known residuals.

    Parameters
    ----------
    name : str
    vertices : ndarray, shape (n, 3)
        In mm.
    triangles : ndarray of int, shape (m, 3)
        Counter-clockwise seen from outside.
    points : ndarray, shape (k, 3)
        In mm.
    """

    name: str
    vertices: FloatArray
    triangles: IntArray
    points: FloatArray

    @cached_property
    def nearest(self) -> tuple[NDArray[np.int64], BoolArray]:
        """Return the nearest point of each triangle, and whether none is near."""
        away, nearest = KDTree(self.points).query(self.vertices[self.triangles].mean(axis=1))
        return np.asarray(nearest), np.asarray(away > FARTHEST_MM)


@dataclass(frozen=True, eq=False)
class Seen:
    """A solid seen from one side.

    Parameters
    ----------
    solid : Solid
    side : str
    view : tuple of ndarray
        See `basis`.
    panel : Panel
        Its panel in the first row of the drawing.
    front : ndarray of int, shape (rows, columns)
        The triangle at each pixel of the panel; -1 for none.
    light : ndarray, shape (m,)
        Factor of the colour of each triangle.
    """

    solid: Solid
    side: str
    view: View
    panel: Panel
    front: NDArray[np.int64]
    light: FloatArray


def seen_from_all_sides(solids: Sequence[Solid]) -> list[Seen]:
    """Return every solid from both sides, at one scale that fills the width of the page."""
    views = [(solid, side, basis(way)) for solid in solids for side, way in SIDES]
    frames = [_frame(solid.vertices, across, up) for solid, _, (across, up, _) in views]
    room = WIDTH_PX - BAR_PX - BETWEEN_PX * len(views)
    per_mm = room / sum(right - left for left, right, _, _ in frames)
    tallest = per_mm * max(top - bottom for _, _, bottom, top in frames)
    seen, x = [], 0.0
    for (solid, side, view), frame in zip(views, frames, strict=True):
        left, right, bottom, top = frame
        panel = Panel(frame, x, HEAD_PX + tallest - per_mm * (top - bottom), per_mm)
        seen.append(Seen(solid, side, view, panel, _front(solid, view, panel), _light(solid, view)))
        x += per_mm * (right - left) + BETWEEN_PX
    return seen


def surface_map(seen: Sequence[Seen], residuals: Residuals, most_mm: float) -> Svg:
    """Return a map of the residuals of one scan, with a row for each model.

    Parameters
    ----------
    seen : sequence of Seen
    residuals : mapping of str to mapping of str to (ndarray, ndarray), each of shape (k,)
        See `Residuals`.
    most_mm : float
        End of the colour scale.
    """
    colours = ColourScale(SIGNED, most_mm)
    tallest = max(one.panel.up.start for one in seen) - HEAD_PX
    row_px = HEAD_PX + tallest + WORDS_PX
    svg = Svg(WIDTH_PX, row_px * len(residuals))
    for number, (title, values) in enumerate(residuals.items()):
        top = number * row_px
        svg.text(0, top + 14, title, class_="head")
        for one in seen:
            panel = replace(one.panel, y=one.panel.y + top)
            shown = colours_of(one.solid, *values[one.solid.name], colours)
            panel.image(svg, image_uri(_pixels(one, shown)), panel.frame_mm)
            middle = (panel.across.start + panel.across.end) / 2
            for line, words in enumerate((one.solid.name, one.side)):
                y = panel.up.start + 14 + 16 * line
                svg.text(middle, y, words, text_anchor="middle", class_="tick")
            if one.solid is seen[0].solid:
                _triad(svg, panel, one)
    span = (BETWEEN_PX, svg.height - BETWEEN_PX)
    colour_bar(svg, colours, WIDTH_PX - BAR_PX + 12, span, BAR_LABEL, arrows=True)
    return svg


def basis(towards_viewer: FloatArray) -> View:
    """Return unit vectors to the right, up and to the viewer; the nipple points upwards."""
    near = towards_viewer / np.linalg.norm(towards_viewer)
    across = np.cross([0.0, 0.0, 1.0], near)
    across /= np.linalg.norm(across)
    return across, np.cross(near, across), near


def colours_of(
    solid: Solid, residual: FloatArray, noise: FloatArray, colours: ColourScale
) -> FloatArray:
    """Return the unshaded colour of each triangle, shape (m, 3).

    It is grey if the residual of the nearest point is within the noise, paler if no point is near.
    """
    nearest, unknown = solid.nearest
    shown = colours.at(residual)
    shown[np.abs(residual) < SIGNIFICANT * noise] = to_rgba(FAINT)[:3]
    shown = shown[nearest]
    shown[unknown] = to_rgba(UNKNOWN)[:3]
    return shown


def _frame(vertices: FloatArray, across: FloatArray, up: FloatArray) -> Frame:
    right, upwards = vertices @ across, vertices @ up
    left, top = right.min() - MARGIN_MM, upwards.max() + MARGIN_MM
    return float(left), float(right.max() + MARGIN_MM), float(upwards.min() - MARGIN_MM), float(top)


def _front(solid: Solid, view: View, panel: Panel) -> NDArray[np.int64]:
    left, right, bottom, top = panel.frame_mm
    across, up, near = view
    per_mm = DOTS * panel.per_mm
    flat = np.stack([solid.vertices @ across - left, solid.vertices @ up - bottom], axis=-1)
    return front_triangles(
        per_mm * flat[solid.triangles],
        (solid.vertices @ near)[solid.triangles].mean(axis=1),
        round(per_mm * (top - bottom)),
        round(per_mm * (right - left)),
    )


def _light(solid: Solid, view: View) -> FloatArray:
    across, up, near = view
    a, b, c = (solid.vertices[corner] for corner in solid.triangles.T)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    lamp = near + 0.5 * up - 0.5 * across
    light = np.rint(STEPS * np.abs(normals @ (lamp / np.linalg.norm(lamp)))) / STEPS
    return np.asarray(AMBIENT + (1 - AMBIENT) * light)


def _pixels(one: Seen, colours: FloatArray) -> NDArray[np.uint8]:
    """Return an image of shaded triangles, shape (rows, columns, 4), elsewhere transparent."""
    shaded = np.zeros((len(colours) + 1, 4), np.uint8)  # the last row is for no triangle
    shaded[:-1, :3] = np.rint(255 * colours * one.light[:, None])
    shaded[:-1, 3] = 255
    return shaded[one.front]


def _triad(svg: Svg, panel: Panel, one: Seen) -> None:
    """Draw the coordinate axes in the free corner next to a long body."""
    across, up, _ = one.view
    vertices = one.solid.vertices
    length = AXIS * float(np.ptp(vertices, axis=0).max())
    directions = length * np.stack([np.eye(3) @ across, np.eye(3) @ up], axis=1)
    reach = 1.4 * np.abs(directions).max(axis=0)
    start = np.array([(vertices @ across).max() - reach[0], (vertices @ up).min() + reach[1] / 2])
    x, y = _pixel(panel, start)
    for name, direction in zip("xyz", directions, strict=True):
        tip_x, tip_y = _pixel(panel, start + direction)
        svg.add("path", d=f"M{x:.1f} {y:.1f}L{tip_x:.1f} {tip_y:.1f}", class_="arrow")
        turn = np.degrees(np.arctan2(tip_y - y, tip_x - x))
        place = f"translate({tip_x:.1f} {tip_y:.1f}) rotate({turn:.0f})"
        head = f"M{-ARROW_PX} {-ARROW_PX / 2}L0 0L{-ARROW_PX} {ARROW_PX / 2}"
        svg.add("path", d=head, class_="arrow", transform=place)
        name_x, name_y = _pixel(panel, start + 1.3 * direction)
        svg.text(name_x, name_y + 4, name, text_anchor="middle", class_="axis-name")


def _pixel(panel: Panel, place_mm: FloatArray) -> tuple[float, float]:
    across, up = place_mm.tolist()
    return panel.across.at(across), panel.up.at(up)
