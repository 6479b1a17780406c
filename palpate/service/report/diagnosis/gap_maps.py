"""Maps of the gap: points of an interface seen from three sides, and surfaces in three dimensions.

Triangles of the body at rest are projected orthographically with a depth buffer, and shaded by a
light at the viewer's upper left. A triangle has the colour of the nearest point of its interface.
All scans and models share the same views, so the visible triangle at each pixel is computed once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from palpate.service.report.drawing.colours import SIGNED, ColourScale, colour_bar, to_rgba
from palpate.service.report.drawing.raster import front_triangles, image_uri
from palpate.service.report.drawing.svg import BELOW_PX, LEFT_PX, Frame, Panel, Svg
from palpate.service.report.drawing.volume_sections import AXES
from palpate.storage.values import BoolArray, FloatArray, IntArray

# Residuals below this number of standard deviations are drawn grey.
SIGNIFICANT = 2.0
SMALLEST_RANGE_MM = 0.5
LEAST_RANGE_NOISES = 10.0
FAINT_COLOUR = "#d3d8de"
# (across, up): columns of (x, y, z), and the title of the view.
POINT_VIEWS = (
    (0, 1, "seen towards the chest wall"),
    (0, 2, "seen along y"),
    (1, 2, "seen along x"),
)
POINT_MAP_PX = 998.0
POINT_BAR_PX, POINT_HEAD_PX, POINT_LINE_PX = 100.0, 24.0, 16.0
# Margin around the points, relative to their largest extent.
POINT_MARGIN = 0.04
GAP_BAR_LABEL = "model outside (+) or inside (−), mm"
# Number of colour levels on either side of zero.
COLOUR_LEVELS = 64


def gap_range_mm(before: FloatArray, noise: FloatArray) -> float:
    """Return the end of the colour scale: the 98 % quantile of the significant residuals."""
    loud = np.abs(before)[np.abs(before) >= SIGNIFICANT * noise]
    least = min(SMALLEST_RANGE_MM, LEAST_RANGE_NOISES * float(noise.max()))
    return max(least, float(np.quantile(loud, 0.98)) if loud.size else 0.0)


def residual_map(
    points: FloatArray, rows: Mapping[str, FloatArray], noise: FloatArray, most_mm: float
) -> Svg:
    """Return a map of the signed residuals of one interface in one scan.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points in the scan at rest, in mm.
    rows : mapping of str to ndarray, shape (k,)
        Residuals in mm by the title of their row, on one colour scale.
    noise : ndarray, shape (k,)
        Standard deviations in mm.
    most_mm : float
        End of the colour scale.
    """
    flat = not np.ptp(points[:, 2])
    views = ((0, 1, "in the plane of the section"),) if flat else POINT_VIEWS
    margin = POINT_MARGIN * float(np.ptp(points, axis=0).max())
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    room = POINT_MAP_PX - POINT_BAR_PX - LEFT_PX * len(views)
    per_mm = room / float(sum(high[across] - low[across] for across, _, _ in views))
    tallest = per_mm * float(max(high[up] - low[up] for _, up, _ in views))
    svg = Svg(POINT_MAP_PX, 0)
    colours = ColourScale(SIGNED, most_mm)
    bottom = 0.0
    for number, (title, residual) in enumerate(rows.items()):
        top, last = bottom + POINT_HEAD_PX, number == len(rows) - 1
        bottom = top + tallest + BELOW_PX
        svg.text(LEFT_PX, top - 9, title, class_="head")
        x = LEFT_PX
        for across, up, view in views:
            frame = (*_extent_along(low, high, across), *_extent_along(low, high, up))
            panel = Panel(frame, x, top + tallest - per_mm * (frame[3] - frame[2]), per_mm)
            panel.axes(svg, f"{AXES[across]}, mm", f"{AXES[up]}, mm", [view] if last else [])
            places = [
                (panel.across.at(x_mm), panel.up.at(y_mm))
                for x_mm, y_mm in points[:, [across, up]].tolist()
            ]
            _draw_dots(svg, places, residual, noise, colours)
            x += LEFT_PX + per_mm * (frame[1] - frame[0])
    svg.height = bottom + POINT_LINE_PX
    colour_bar(
        svg,
        colours,
        POINT_MAP_PX - POINT_BAR_PX + 24,
        (POINT_HEAD_PX, bottom - BELOW_PX),
        GAP_BAR_LABEL,
        arrows=True,
    )
    return svg


def _extent_along(low: FloatArray, high: FloatArray, axis: int) -> tuple[float, float]:
    return float(low[axis]), float(high[axis])


def _draw_dots(
    svg: Svg,
    places: list[tuple[float, float]],
    residual: FloatArray,
    noise: FloatArray,
    colours: ColourScale,
) -> None:
    """Draw points, those within the noise first and the largest residuals last."""
    loud = np.abs(residual) >= SIGNIFICANT * noise
    svg.dots([places[k] for k in np.flatnonzero(~loud).tolist()], "quiet")
    level = np.clip(np.rint(COLOUR_LEVELS * residual / colours.end), -COLOUR_LEVELS, COLOUR_LEVELS)
    shown = sorted(set(level[loud].tolist()), key=abs)
    for colour_level, shade in zip(
        shown, colours.written(colours.end * np.array(shown) / COLOUR_LEVELS), strict=True
    ):
        own = np.flatnonzero(loud & (level == colour_level)).tolist()
        svg.dots([places[k] for k in own], "loud", stroke=shade)


SURFACE_MAP_PX = 998.0
# Triangles farther from every point have no colour: the rim at the chest wall, thin strands.
FARTHEST_MM = 9.0
UNKNOWN_COLOUR = "#f1f2f4"
# Opposite corners of the body, both from the side of the nipple.
SIDES = (
    ("seen from +x, +y", np.array([0.45, 0.70, 0.55])),
    ("seen from −x, −y", np.array([-0.45, -0.70, 0.55])),
)
MARGIN_MM = 2.0
SURFACE_BAR_PX, BETWEEN_PX, SURFACE_HEAD_PX, WORDS_PX = 90.0, 6.0, 24.0, 40.0
# Image pixels per page pixel, for high-resolution screens.
DOTS_PER_PX = 1.875
# Fraction of ambient light.
AMBIENT = 0.72
# Quantised light, and edges without antialiasing, make an image a third of the size.
LIGHT_STEPS = 16
# Length of the drawn axes, relative to the longest side of the body.
AXIS_LENGTH = 0.12
ARROW_PX = 5.0

# Unit vectors to the right, up and to the viewer.
ViewBasis = tuple[FloatArray, FloatArray, FloatArray]
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
class SeenSolid:
    """A solid seen from one side.

    Parameters
    ----------
    solid : Solid
    side : str
    view : tuple of ndarray
        See `view_basis`.
    panel : Panel
        Its panel in the first row of the drawing.
    front : ndarray of int, shape (rows, columns)
        The triangle at each pixel of the panel; -1 for none.
    light : ndarray, shape (m,)
        Factor of the colour of each triangle.
    """

    solid: Solid
    side: str
    view: ViewBasis
    panel: Panel
    front: NDArray[np.int64]
    light: FloatArray


def seen_from_all_sides(solids: Sequence[Solid]) -> list[SeenSolid]:
    """Return every solid from both sides, at one scale that fills the width of the page."""
    views = [(solid, side, view_basis(way)) for solid in solids for side, way in SIDES]
    frames = [_solid_frame(solid.vertices, across, up) for solid, _, (across, up, _) in views]
    room = SURFACE_MAP_PX - SURFACE_BAR_PX - BETWEEN_PX * len(views)
    per_mm = room / sum(right - left for left, right, _, _ in frames)
    tallest = per_mm * max(top - bottom for _, _, bottom, top in frames)
    seen, x = [], 0.0
    for (solid, side, view), frame in zip(views, frames, strict=True):
        left, right, bottom, top = frame
        panel = Panel(frame, x, SURFACE_HEAD_PX + tallest - per_mm * (top - bottom), per_mm)
        seen.append(
            SeenSolid(
                solid, side, view, panel, _front_triangles(solid, view, panel), _light(solid, view)
            )
        )
        x += per_mm * (right - left) + BETWEEN_PX
    return seen


def surface_map(seen: Sequence[SeenSolid], residuals: Residuals, most_mm: float) -> Svg:
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
    tallest = max(seen_solid.panel.up.start for seen_solid in seen) - SURFACE_HEAD_PX
    row_px = SURFACE_HEAD_PX + tallest + WORDS_PX
    svg = Svg(SURFACE_MAP_PX, row_px * len(residuals))
    for number, (title, values) in enumerate(residuals.items()):
        top = number * row_px
        svg.text(0, top + 14, title, class_="head")
        for seen_solid in seen:
            panel = replace(seen_solid.panel, y=seen_solid.panel.y + top)
            shown = triangle_colours(seen_solid.solid, *values[seen_solid.solid.name], colours)
            panel.image(svg, image_uri(_pixels(seen_solid, shown)), panel.frame_mm)
            middle = (panel.across.start + panel.across.end) / 2
            for line, words in enumerate((seen_solid.solid.name, seen_solid.side)):
                y = panel.up.start + 14 + 16 * line
                svg.text(middle, y, words, text_anchor="middle", class_="tick")
            if seen_solid.solid is seen[0].solid:
                _triad(svg, panel, seen_solid)
    span = (BETWEEN_PX, svg.height - BETWEEN_PX)
    colour_bar(svg, colours, SURFACE_MAP_PX - SURFACE_BAR_PX + 12, span, GAP_BAR_LABEL, arrows=True)
    return svg


def view_basis(towards_viewer: FloatArray) -> ViewBasis:
    """Return unit vectors to the right, up and to the viewer; the nipple points upwards."""
    near = towards_viewer / np.linalg.norm(towards_viewer)
    across = np.cross([0.0, 0.0, 1.0], near)
    across /= np.linalg.norm(across)
    return across, np.cross(near, across), near


def triangle_colours(
    solid: Solid, residual: FloatArray, noise: FloatArray, colours: ColourScale
) -> FloatArray:
    """Return the unshaded colour of each triangle, shape (m, 3).

    It is grey if the residual of the nearest point is within the noise, paler if no point is near.
    """
    nearest, unknown = solid.nearest
    shown = colours.at(residual)
    shown[np.abs(residual) < SIGNIFICANT * noise] = to_rgba(FAINT_COLOUR)[:3]
    shown = shown[nearest]
    shown[unknown] = to_rgba(UNKNOWN_COLOUR)[:3]
    return shown


def _solid_frame(vertices: FloatArray, across: FloatArray, up: FloatArray) -> Frame:
    right, upwards = vertices @ across, vertices @ up
    left, top = right.min() - MARGIN_MM, upwards.max() + MARGIN_MM
    return float(left), float(right.max() + MARGIN_MM), float(upwards.min() - MARGIN_MM), float(top)


def _front_triangles(solid: Solid, view: ViewBasis, panel: Panel) -> NDArray[np.int64]:
    left, right, bottom, top = panel.frame_mm
    across, up, near = view
    per_mm = DOTS_PER_PX * panel.per_mm
    flat = np.stack([solid.vertices @ across - left, solid.vertices @ up - bottom], axis=-1)
    return front_triangles(
        per_mm * flat[solid.triangles],
        (solid.vertices @ near)[solid.triangles].mean(axis=1),
        round(per_mm * (top - bottom)),
        round(per_mm * (right - left)),
    )


def _light(solid: Solid, view: ViewBasis) -> FloatArray:
    across, up, near = view
    a, b, c = (solid.vertices[corner] for corner in solid.triangles.T)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    lamp = near + 0.5 * up - 0.5 * across
    light = np.rint(LIGHT_STEPS * np.abs(normals @ (lamp / np.linalg.norm(lamp)))) / LIGHT_STEPS
    return np.asarray(AMBIENT + (1 - AMBIENT) * light)


def _pixels(one: SeenSolid, colours: FloatArray) -> NDArray[np.uint8]:
    """Return an image of shaded triangles, shape (rows, columns, 4), elsewhere transparent."""
    shaded = np.zeros((len(colours) + 1, 4), np.uint8)  # the last row is for no triangle
    shaded[:-1, :3] = np.rint(255 * colours * one.light[:, None])
    shaded[:-1, 3] = 255
    return shaded[one.front]


def _triad(svg: Svg, panel: Panel, one: SeenSolid) -> None:
    """Draw the coordinate axes in the free corner next to a long body."""
    across, up, _ = one.view
    vertices = one.solid.vertices
    length = AXIS_LENGTH * float(np.ptp(vertices, axis=0).max())
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
