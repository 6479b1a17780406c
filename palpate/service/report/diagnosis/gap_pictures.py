"""Pictures of where model and scans differ, as far as the store has the data.

They are sections through observed and predicted bodies, sections through the map of causes, and
maps of the gap on surfaces or at points.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from palpate.service.diagnosis.magnitude_words import signed
from palpate.service.report.diagnosis.gap_maps import (
    SIGNIFICANT,
    Solid,
    gap_range_mm,
    residual_map,
    seen_from_all_sides,
    surface_map,
)
from palpate.service.report.drawing.colours import (
    BLUE,
    VERMILION,
    ColourScale,
    colour_bar,
    colour_table,
)
from palpate.service.report.drawing.raster import png_uri
from palpate.service.report.drawing.svg import (
    ABOVE_PX,
    BELOW_PX,
    LEFT_PX,
    Contour,
    Panel,
    Svg,
    contours,
)
from palpate.service.report.drawing.volume_sections import (
    AXES,
    VIEWS,
    Section,
    View,
    clipped,
    frame_mm,
    middle_mm,
    section,
)
from palpate.service.report.page.page_elements import Picture, small_chart
from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Tissue, Triple, Volume
from palpate.workers.diagnosis.outcome.diagnosis_summary import CauseMapSummary
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES

SECTIONS_PX = 998.0
# Maximum width of a column of sections and maximum total height, in pixels.
MOST_SECTION_PX = (566.0, 576.0)
RIGHT_PX, TITLE_PX = 8.0, 20.0
# Width of the bar of a colour scale.
CAUSE_BAR_PX = 96.0
BODY_COLOUR, GLAND_COLOUR, QUIET_COLOUR = "#8a94a12e", "#8a94a180", "#8a94a170"
# Labels of an overlay, and their colours.
IN_BOTH, GLAND_IN_BOTH, TOO_MUCH, TOO_LITTLE = 1, 2, 3, 4
OVERLAY_COLOURS = colour_table(
    {IN_BOTH: BODY_COLOUR, GLAND_IN_BOTH: GLAND_COLOUR, TOO_MUCH: VERMILION, TOO_LITTLE: BLUE}
)
# Hues other than those of "outside" and "inside".
CAUSE_COLOURS = ("#0b4f3c", "#1b8a6b", "#a3cfc0", "#d0ccc8", "#d0a3c6", "#9b3a86", "#521047")
SMALLEST_SCORE = 4.0
# Labels of a map of causes: 0 for unknown, the steps of its scale, and insignificant scores.
SCORE_STEPS = 253
QUIET_LABEL = SCORE_STEPS + 1


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
    svg, grid = _panel_grid(cuts, list(predicted), 0.0)
    for line, cut in zip(grid, cuts, strict=True):
        for panel, volume in zip(line, predicted.values(), strict=True):
            model = section(volume, cut.view, middle[cut.view.normal])
            _draw_section(svg, panel, overlay_labels(cut.seen, model), OVERLAY_COLOURS, cut, middle)
    return svg


def overlay_legend() -> list[tuple[str, str]]:
    """Return (colour, meaning) pairs of an overlay."""
    return [
        (VERMILION, "model outside: predicted, not in the scan"),
        (BLUE, "model inside: in the scan, not predicted"),
        (GLAND_COLOUR, "glandular tissue in both"),
        (BODY_COLOUR, "other tissue in both"),
    ]


def overlay_labels(seen: Section, model: Section) -> Section:
    """Return the labels of an overlay, 0 for air.

    Excess body or glandular tissue of the model is `TOO_MUCH`, missing tissue `TOO_LITTLE`. The
    sections must have the same box.
    """
    labels = np.zeros(seen.values.shape, np.uint8)
    labels[_inside_body(seen)] = IN_BOTH
    labels[_inside_gland(seen) & _inside_gland(model)] = GLAND_IN_BOTH
    # Completely missing tissue also counts as missing gland: the outline is drawn last.
    for of in (_inside_gland, _inside_body):
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
    svg, grid = _panel_grid(cuts, list(maps), CAUSE_BAR_PX)
    loudest = max(float(np.nanmax(np.abs(m.values), initial=0.0)) for m in maps.values())
    colours = ColourScale(CAUSE_COLOURS, max(SMALLEST_SCORE, loudest))
    scored = [score_labels(scores, colours) for scores in maps.values()]
    table = score_colours(colours)
    for line, cut in zip(grid, cuts, strict=True):
        view = cut.view
        for panel, labels in zip(line, scored, strict=True):
            _draw_section(svg, panel, section(labels, view, at[view.normal]), table, cut, at)
            x, y = panel.across.at(at[view.across]), panel.up.at(at[view.up])
            svg.add("path", d=f"M{x - 5:.1f} {y:.1f}h10M{x:.1f} {y - 5:.1f}v10", class_="whisker")
    colour_bar(
        svg,
        colours,
        svg.width - CAUSE_BAR_PX + 24,
        (TITLE_PX + ABOVE_PX, svg.height - BELOW_PX),
        "score: softer (−) or stiffer (+) tissue explains the gap",
        strokes=(-reached_by_noise, reached_by_noise),
    )
    return svg


def score_labels(scores: Volume, colours: ColourScale) -> Volume:
    """Return labels of a map of causes; see `score_colours`."""
    known = np.nan_to_num(scores.values)
    share = (known / colours.end + 1) / 2
    labels = 1 + np.clip(share * SCORE_STEPS, 0, SCORE_STEPS - 1).astype(np.uint8)
    labels[np.abs(known) < SIGNIFICANT] = QUIET_LABEL
    labels[np.isnan(scores.values)] = 0
    return Volume(labels, scores.spacing_mm, scores.origin_mm)


def score_colours(colours: ColourScale) -> NDArray[np.uint8]:
    """Return colours of the labels: grey for small scores, transparent for unknown ones."""
    table = colour_table({QUIET_LABEL: QUIET_COLOUR})
    middles = colours.end * (2 * (np.arange(SCORE_STEPS) + 0.5) / SCORE_STEPS - 1)
    table[1 : 1 + SCORE_STEPS, :3] = np.rint(255 * colours.at(middles))
    return table


class _Cut:
    """A section of the body as a background, with its frame and interfaces."""

    def __init__(self, view: View, seen: Section) -> None:
        self.view, self.seen, self.frame = view, seen, frame_mm([seen])
        self.lines: list[Contour] = [
            line
            for inside in (_inside_body(seen), _inside_gland(seen))
            for line in contours(inside)
        ]


def _cut(body: Volume, view: View, at: Triple) -> _Cut:
    return _Cut(view, section(body, view, at[view.normal]))


def _panel_grid(
    cuts: Sequence[_Cut], titles: Sequence[str], beside_px: float
) -> tuple[Svg, list[list[Panel]]]:
    """Return a drawing with a row for each section and a column for each title.

    All have the same scale, as large as the page allows.
    """
    widest = max(right - left for left, right, _, _ in (cut.frame for cut in cuts))
    heights = [top - bottom for _, _, bottom, top in (cut.frame for cut in cuts)]
    room = (SECTIONS_PX - beside_px) / len(titles) - LEFT_PX - RIGHT_PX
    per_mm = min(min(room, MOST_SECTION_PX[0]) / widest, MOST_SECTION_PX[1] / sum(heights))
    column = LEFT_PX + per_mm * widest + RIGHT_PX
    svg = Svg(len(titles) * column + beside_px, 0)
    lefts = [LEFT_PX + number * column for number in range(len(titles))]
    for x, title in zip(lefts, titles, strict=True):
        svg.text(x, 14, title, class_="head")
    grid, y = [], TITLE_PX
    for cut, height in zip(cuts, heights, strict=True):
        grid.append([Panel(cut.frame, x, y + ABOVE_PX, per_mm) for x in lefts])
        y += ABOVE_PX + per_mm * height + BELOW_PX
    svg.height = y
    return svg, grid


def _draw_section(
    svg: Svg, panel: Panel, shown: Section, table: NDArray[np.uint8], cut: _Cut, at: Triple
) -> None:
    view, inner = cut.view, clipped(shown, panel.frame_mm)
    panel.image(svg, png_uri(inner.values, table), inner.extent_mm, class_="voxels")
    panel.lines(svg, cut.lines, cut.seen.spacing_mm, cut.seen.origin_mm)
    where = f"{view.name}, {AXES[view.normal]} = {signed(at[view.normal], 0)} mm"
    svg.text(panel.x, panel.y - 5, where, class_="tick")
    panel.axes(svg, f"{AXES[view.across]}, mm", f"{AXES[view.up]}, mm")


def _inside_body(shown: Section) -> BoolArray:
    return np.asarray(shown.values != Tissue.AIR)


def _inside_gland(shown: Section) -> BoolArray:
    return np.asarray(shown.values == Tissue.GLANDULAR)


def titled_models(maps: Mapping[str, object], named: str) -> Iterator[tuple[str, str]]:
    """Yield (key, title) of "before" and "after", if present."""
    for key, title in (("before", "nominal model"), ("after", f"with {named}")):
        if key in maps:
            yield key, title


# No map is drawn of an interface with fewer points.
FEW_POINTS = 5
SHAPE_PARTS = ("vertices", "triangles")


def gap_map_pictures(
    found: Arrays, scans: Sequence[str], named: str, surfaces: Sequence[str]
) -> Iterator[Picture]:
    """Yield maps of the signed residuals of every scan, on one colour scale.

    They are drawn on surfaces, averaged around each point, if the store has these; otherwise as
    points seen from three sides.
    """
    own = {name: found["interface"] == number for number, name in enumerate(surfaces)}
    own = {name: mask for name, mask in own.items() if mask.sum() >= FEW_POINTS}
    if not own:
        return
    drawn_on = _surface_maps if has_surface_gaps(found) else _point_maps
    yield from drawn_on(found, scans, named, own)


def _surface_maps(
    found: Arrays, scans: Sequence[str], named: str, own: Mapping[str, BoolArray]
) -> Iterator[Picture]:
    most = gap_range_mm(found["local_before"], found["local_before_sd"])
    seen = seen_from_all_sides([_solid(found, name, mask) for name, mask in own.items()])
    for scan, scan_name in enumerate(scans):
        local = {
            title: {
                name: (found[f"local_{key}"][scan, mask], found[f"local_{key}_sd"][scan, mask])
                for name, mask in own.items()
            }
            for key, title in titled_models(found, named)
        }
        shares = [
            f"{name}: {_share_beyond_noise(found, scan, named, mask)}" for name, mask in own.items()
        ]
        drawn = surface_map(seen, local, most)
        yield _captioned(drawn, f"Scan at {scan_name}", _beyond_words("; ".join(shares)))


def _point_maps(
    found: Arrays, scans: Sequence[str], named: str, own: Mapping[str, BoolArray]
) -> Iterator[Picture]:
    most = gap_range_mm(found["before"], found["noise"])
    for scan, scan_name in enumerate(scans):
        for name, mask in own.items():
            rows = {title: found[key][scan, mask] for key, title in titled_models(found, named)}
            drawn = residual_map(found["points"][mask], rows, found["noise"][scan, mask], most)
            title = f"{name.capitalize()}, scan at {scan_name}"
            yield _captioned(
                drawn, title, _beyond_words(_share_beyond_noise(found, scan, named, mask))
            )


def _solid(found: Arrays, name: str, own: BoolArray) -> Solid:
    vertices, triangles = (found[f"shape_{name}_{part}"] for part in SHAPE_PARTS)
    return Solid(name, vertices.astype(np.float64), triangles, found["points"][own])


def has_surface_gaps(found: Arrays) -> bool:
    """Check whether the store has the shapes of the interfaces and residuals averaged on them."""
    return "local_before" in found and f"shape_{INTERFACES[0].name}_vertices" in found


def overlay_pictures(found: Arrays, scans: Sequence[str], named: str) -> Iterator[Picture]:
    """Yield sections of the observed and predicted bodies of every scan in the store."""
    for scan, name in enumerate(scans):
        if f"labels_{scan}" not in found:
            continue
        stack, frame = found[f"labels_{scan}"], found[f"labels_{scan}_frame"]
        observed, *models = (_volume(labels, frame) for labels in stack)
        keys = dict(zip(("before", "after"), models, strict=False))
        shown = {title: keys[key] for key, title in titled_models(keys, named)}
        middle = middle_mm(observed, (Tissue.GLANDULAR,))
        yield _captioned(
            overlays(observed, shown, middle),
            f"Scan at {name}",
            "sections through the middle of the glandular tissue of the scan; lines are its "
            "interfaces",
        )


def cause_map_picture(found: Arrays, causes: CauseMapSummary | None, named: str) -> Picture | None:
    """Return the map of causes; None if there is none."""
    if causes is None or "cause_before" not in found:
        return None
    before = causes.before
    body = _volume(found["labels_rest"], found["labels_rest_frame"])
    keys = {key: found[f"cause_{key}"] for key in ("before", "after") if f"cause_{key}" in found}
    shown = {
        title: _volume(keys[key], found["cause_frame"]) for key, title in titled_models(keys, named)
    }
    point: Triple = (before.x_mm, before.y_mm, before.z_mm)
    drawn = cause_sections(shown, body, point, before.reached_by_noise)
    return _captioned(drawn, "Map of causes", cause_words(causes))


def cause_words(causes: CauseMapSummary) -> str:
    """Return the place of the highest score of the map, and whether it exceeds the noise."""
    before = causes.before
    way = "stiffer" if before.score > 0 else "softer"
    noise = before.reached_by_noise
    coordinates = {"x": before.x_mm, "y": before.y_mm, "z": before.z_mm}
    place = ", ".join(f"{axis} = {signed(value, 0)}" for axis, value in coordinates.items())
    verdict = (
        "more than noise alone reaches anywhere in the body"
        if abs(before.score) > noise
        else "no more than noise alone reaches somewhere in the body"
    )
    return (
        f"{way} tissue at {place} mm (the cross) would explain the gap best. Its score of "
        f"{signed(before.score, 1)} is {verdict} (±{noise:.1f} in 5 of 100 cases, the strokes on "
        "the scale)"
    )


def _beyond_words(said: str) -> str:
    return f"points beyond twice the noise of a point: {said}. Noise alone would put 5 % there"


def _share_beyond_noise(found: Arrays, scan: int, named: str, own: BoolArray) -> str:
    """Return the fraction of points beyond twice the noise, by model."""
    limit = SIGNIFICANT * found["noise"][scan, own]
    shares = {
        title: (np.abs(found[key][scan, own]) >= limit).mean()
        for key, title in titled_models(found, named)
    }
    return ", ".join(f"{100 * share:.0f} % ({title})" for title, share in shares.items())


def _captioned(drawn: Svg, title: str, words: str) -> Picture:
    return small_chart(drawn, f"{title}: {words}.", Markup("<b>{}</b>: {}.").format(title, words))


def _volume(values: Any, frame: FloatArray) -> Volume:
    (dx, dy, dz), (x, y, z) = frame.tolist()
    return Volume(values, (dx, dy, dz), (x, y, z))
