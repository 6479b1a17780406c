"""Sections through observed and predicted bodies, and through the map of causes."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.service.diagnosis.words import signed
from palpate.service.report.diagnosis.maps import SIGNIFICANT
from palpate.service.report.drawing.colour_scale import ColourScale, colour_bar
from palpate.service.report.drawing.contours import Line, contours
from palpate.service.report.drawing.palette import BLUE, VERMILION, lookup
from palpate.service.report.drawing.panel import ABOVE_PX, BELOW_PX, LEFT_PX, Panel
from palpate.service.report.drawing.raster import png_uri
from palpate.service.report.drawing.slices import (
    AXES,
    VIEWS,
    Section,
    View,
    clipped,
    frame_mm,
    section,
)
from palpate.service.report.drawing.svg import Svg
from palpate.storage.values import BoolArray, Tissue, Triple, Volume

WIDTH_PX = 998.0
# Maximum width of a column of sections and maximum total height, in pixels.
MOST_PX = (566.0, 576.0)
RIGHT_PX, HEAD_PX = 8.0, 20.0
# Width of the bar of a colour scale.
BAR_PX = 96.0
BODY, GLAND, QUIET = "#8a94a12e", "#8a94a180", "#8a94a170"
# Labels of an overlay, and their colours.
IN_BOTH, GLAND_IN_BOTH, TOO_MUCH, TOO_LITTLE = 1, 2, 3, 4
OVERLAY = lookup({IN_BOTH: BODY, GLAND_IN_BOTH: GLAND, TOO_MUCH: VERMILION, TOO_LITTLE: BLUE})
# Hues other than those of "outside" and "inside".
CAUSES = ("#0b4f3c", "#1b8a6b", "#a3cfc0", "#d0ccc8", "#d0a3c6", "#9b3a86", "#521047")
SMALLEST_SCORE = 4.0
# Labels of a map of causes: 0 for unknown, the steps of its scale, and insignificant scores.
STEPS = 253
QUIET_LABEL = STEPS + 1


def overlays(observed: Volume, predicted: Mapping[str, Volume], middle: Triple) -> Svg:
    """Return the differences between model and scan in three sections.

    Parameters
    ----------
    observed : Volume
        `Tissue` labels.
    predicted : mapping of str to Volume
        Volumes on the lattice of `observed`, by the title of their column.
    middle : tuple of float
        Point (x, y, z) in mm that the sections pass through.
    """
    cuts = [_cut(observed, view, middle) for view in VIEWS]
    svg, grid = _grid(cuts, list(predicted), 0.0)
    for line, cut in zip(grid, cuts, strict=True):
        for panel, volume in zip(line, predicted.values(), strict=True):
            model = section(volume, cut.view, middle[cut.view.normal])
            _draw(svg, panel, compared(cut.seen, model), OVERLAY, cut, middle)
    return svg


def overlay_legend() -> list[tuple[str, str]]:
    """Return (colour, meaning) pairs of an overlay."""
    return [
        (VERMILION, "model outside: predicted, not in the scan"),
        (BLUE, "model inside: in the scan, not predicted"),
        (GLAND, "glandular tissue in both"),
        (BODY, "other tissue in both"),
    ]


def compared(seen: Section, model: Section) -> Section:
    """Return the labels of an overlay, 0 for air.

    Excess body or glandular tissue of the model is `TOO_MUCH`, missing tissue `TOO_LITTLE`. The
    sections must have the same box.
    """
    labels = np.zeros(seen.values.shape, np.uint8)
    labels[_body(seen)] = IN_BOTH
    labels[_gland(seen) & _gland(model)] = GLAND_IN_BOTH
    # Completely missing tissue also counts as missing gland: the outline is drawn last.
    for of in (_gland, _body):
        labels[of(model) & ~of(seen)] = TOO_MUCH
        labels[of(seen) & ~of(model)] = TOO_LITTLE
    return Section(labels, seen.spacing_mm, seen.origin_mm)


def cause_sections(
    maps: Mapping[str, Volume], body: Volume, at: Triple, reached_by_noise: float
) -> Svg:
    """Return scores of "locally stiffer" in three sections, a column for each map.

    Parameters
    ----------
    maps : mapping of str to Volume
        Scores on one lattice by the title of their column; nan where the scans are uninformative.
    body : Volume
        `Tissue` labels of the body at rest.
    at : tuple of float
        Point (x, y, z) in mm that the sections pass through.
    reached_by_noise : float
        Level that noise alone exceeds somewhere in 5 of 100 cases; marked on the scale.
    """
    cuts = [_cut(body, view, at) for view in VIEWS]
    svg, grid = _grid(cuts, list(maps), BAR_PX)
    loudest = max(float(np.nanmax(np.abs(m.values), initial=0.0)) for m in maps.values())
    colours = ColourScale(CAUSES, max(SMALLEST_SCORE, loudest))
    scored = [score_labels(scores, colours) for scores in maps.values()]
    table = score_colours(colours)
    for line, cut in zip(grid, cuts, strict=True):
        view = cut.view
        for panel, labels in zip(line, scored, strict=True):
            _draw(svg, panel, section(labels, view, at[view.normal]), table, cut, at)
            x, y = panel.across.at(at[view.across]), panel.up.at(at[view.up])
            svg.add("path", d=f"M{x - 5:.1f} {y:.1f}h10M{x:.1f} {y - 5:.1f}v10", class_="whisker")
    colour_bar(
        svg,
        colours,
        svg.width - BAR_PX + 24,
        (HEAD_PX + ABOVE_PX, svg.height - BELOW_PX),
        "score: softer (−) or stiffer (+) tissue explains the gap",
        strokes=(-reached_by_noise, reached_by_noise),
    )
    return svg


def score_labels(scores: Volume, colours: ColourScale) -> Volume:
    """Return labels of a map of causes; see `score_colours`."""
    known = np.nan_to_num(scores.values)
    share = (known / colours.end + 1) / 2
    labels = 1 + np.clip(share * STEPS, 0, STEPS - 1).astype(np.uint8)
    labels[np.abs(known) < SIGNIFICANT] = QUIET_LABEL
    labels[np.isnan(scores.values)] = 0
    return Volume(labels, scores.spacing_mm, scores.origin_mm)


def score_colours(colours: ColourScale) -> NDArray[np.uint8]:
    """Return colours of the labels: grey for small scores, transparent for unknown ones."""
    table = lookup({QUIET_LABEL: QUIET})
    middles = colours.end * (2 * (np.arange(STEPS) + 0.5) / STEPS - 1)
    table[1 : 1 + STEPS, :3] = np.rint(255 * colours.at(middles))
    return table


class _Cut:
    """A section of the body as a background, with its frame and interfaces."""

    def __init__(self, view: View, seen: Section) -> None:
        self.view, self.seen, self.frame = view, seen, frame_mm([seen])
        self.lines: list[Line] = [
            line for inside in (_body(seen), _gland(seen)) for line in contours(inside)
        ]


def _cut(body: Volume, view: View, at: Triple) -> _Cut:
    return _Cut(view, section(body, view, at[view.normal]))


def _grid(
    cuts: Sequence[_Cut], titles: Sequence[str], beside_px: float
) -> tuple[Svg, list[list[Panel]]]:
    """Return a drawing with a row for each section and a column for each title.

    All have the same scale, as large as the page allows.
    """
    widest = max(right - left for left, right, _, _ in (cut.frame for cut in cuts))
    heights = [top - bottom for _, _, bottom, top in (cut.frame for cut in cuts)]
    room = (WIDTH_PX - beside_px) / len(titles) - LEFT_PX - RIGHT_PX
    per_mm = min(min(room, MOST_PX[0]) / widest, MOST_PX[1] / sum(heights))
    column = LEFT_PX + per_mm * widest + RIGHT_PX
    svg = Svg(len(titles) * column + beside_px, 0)
    lefts = [LEFT_PX + number * column for number in range(len(titles))]
    for x, title in zip(lefts, titles, strict=True):
        svg.text(x, 14, title, class_="head")
    grid, y = [], HEAD_PX
    for cut, height in zip(cuts, heights, strict=True):
        grid.append([Panel(cut.frame, x, y + ABOVE_PX, per_mm) for x in lefts])
        y += ABOVE_PX + per_mm * height + BELOW_PX
    svg.height = y
    return svg, grid


def _draw(
    svg: Svg, panel: Panel, shown: Section, table: NDArray[np.uint8], cut: _Cut, at: Triple
) -> None:
    view, inner = cut.view, clipped(shown, panel.frame_mm)
    panel.image(svg, png_uri(inner.values, table), inner.extent_mm, class_="voxels")
    panel.lines(svg, cut.lines, cut.seen.spacing_mm, cut.seen.origin_mm)
    where = f"{view.name}, {AXES[view.normal]} = {signed(at[view.normal], 0)} mm"
    svg.text(panel.x, panel.y - 5, where, class_="tick")
    panel.axes(svg, f"{AXES[view.across]}, mm", f"{AXES[view.up]}, mm")


def _body(shown: Section) -> BoolArray:
    return np.asarray(shown.values != Tissue.AIR)


def _gland(shown: Section) -> BoolArray:
    return np.asarray(shown.values == Tissue.GLANDULAR)


def titled(maps: Mapping[str, object], named: str) -> Iterator[tuple[str, str]]:
    """Yield (key, title) of "before" and "after", if present."""
    for key, title in (("before", "nominal model"), ("after", f"with {named}")):
        if key in maps:
            yield key, title
