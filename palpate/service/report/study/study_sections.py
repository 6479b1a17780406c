"""Sections of reference, target, best candidate and difference, side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from palpate.service.report.drawing import colours
from palpate.service.report.drawing.colours import Difference
from palpate.service.report.drawing.raster import png_uri
from palpate.service.report.drawing.svg import Contour, Panel, Scale, Svg, contours, tick_text
from palpate.service.report.drawing.volume_sections import (
    AXES,
    Plates,
    Section,
    View,
    clipped,
    difference,
    frame_mm,
    middle_mm,
    section,
)
from palpate.service.report.study.study_data import Bodies
from palpate.storage.values import Tissue, Triple

PANEL_PX = 230.0
PLATE_PX = 1.0
WIDE = 1.4
UNDEFORMED, TARGET, BEST = "Undeformed", "Target", "Best candidate"
_PLATES_AT = {TARGET: "target", BEST: "best"}
TISSUE_COLOURS = colours.colour_table({int(t): c for t, c in colours.TISSUE_PALETTE.items()})
DIFFERENCE_COLOURS = colours.colour_table(
    {int(d): c for d, c in colours.DIFFERENCE_PALETTE.items()}
)
UNDEFORMED, TARGET, BEST = "Undeformed", "Target", "Best candidate"
_PLATES_AT = {TARGET: "target", BEST: "best"}


@dataclass(frozen=True)
class SideBySide:
    """Sections of one view, each with its title; `wide` ones are drawn two in a row."""

    panels: tuple[tuple[str, Markup], ...]
    wide: bool


def sections_side_by_side(
    bodies: Bodies,
    view: View,
    tissues: Sequence[int],
    middle: tuple[Triple | None, Triple | None],
    plates: Mapping[str, Plates],
) -> SideBySide | None:
    """Draw one view of all available bodies; None if there is none.

    Parameters
    ----------
    bodies : Bodies
    view : View
    tissues : sequence of int
        Compared tissues.
    middle : tuple
        Points on the planes through the undeformed body, and through target and best candidate;
        see `section_middles`.
    plates : mapping of str to Plates
        Plates at the ``target`` and the ``best`` candidate.
    """
    shown = cut_bodies(bodies, view, tissues, middle)
    if not shown:
        return None
    frame = left, right, bottom, top = frame_mm([cut for _, cut, _ in shown])
    deformed = middle[1]
    target = next((cut for title, cut, _ in shown if title == TARGET), None)
    panels = []
    for title, cut, differs in shown:
        touched = plates.get(_PLATES_AT.get(title, ""))
        lines = []
        if touched is not None and deformed is not None:
            outwards_mm = PLATE_PX * (right - left) / PANEL_PX
            lines = touched.lines(view, deformed[view.normal], frame, outwards_mm)
        over = target if title == BEST else None
        svg = _panel(cut, frame, view, differs, lines, _outlines(over, tissues))
        panels.append((title, svg.markup(f"{title}, {view.name}", "panel")))
    return SideBySide(tuple(panels), right - left > WIDE * (top - bottom))


def section_middles(bodies: Bodies, tissues: Sequence[int]) -> tuple[Triple | None, Triple | None]:
    """Return the points where the undeformed body and the target are cut, within `tissues`.

    Target and best candidate are cut at the same place.
    """
    first = None if bodies.reference is None else middle_mm(bodies.reference, tissues)
    explained = bodies.target if bodies.target is not None else bodies.best
    return first, None if explained is None else middle_mm(explained, tissues)


def tissue_legend(bodies: Bodies) -> list[tuple[str, str]]:
    """Return (colour, name) of every tissue in a legend."""
    volumes = [v for v in (bodies.reference, bodies.target, bodies.best) if v is not None]
    there = [t for t in bodies.labels if any((v.values == t).any() for v in volumes)]
    return [(colours.TISSUE_PALETTE[Tissue(t)], bodies.labels[t]) for t in there]


def difference_legend() -> list[tuple[str, str]]:
    """Return (colour, meaning) pairs of a difference."""
    meaning = {
        Difference.BOTH: "in both",
        Difference.ONLY_TARGET: "only in the target",
        Difference.ONLY_BEST: "only in the best candidate",
        Difference.BODY: "rest of the body",
    }
    return [(colours.DIFFERENCE_PALETTE[kind], text) for kind, text in meaning.items()]


def cut_bodies(
    bodies: Bodies, view: View, tissues: Sequence[int], middle: tuple[Triple | None, Triple | None]
) -> list[tuple[str, Section, bool]]:
    """Return the title and section of every available body, and of their difference.

    The third value is True for the difference.
    """
    undeformed, deformed = middle
    shown = []
    cuts: dict[str, Section] = {}
    for title, volume, point in (
        (UNDEFORMED, bodies.reference, undeformed),
        (TARGET, bodies.target, deformed),
        (BEST, bodies.best, deformed),
    ):
        if volume is not None and point is not None:
            cuts[title] = section(volume, view, point[view.normal])
            shown.append((title, cuts[title], False))
    if TARGET in cuts and BEST in cuts:
        names = " + ".join(bodies.labels[t] for t in tissues)
        compared = difference(cuts[TARGET], cuts[BEST], tissues)
        shown.append((f"Difference, {names}", compared, True))
    return shown


def _outlines(over: Section | None, tissues: Sequence[int]) -> list[tuple[Section, list[Contour]]]:
    """Return the outline of a body and of its compared tissues in a section."""
    if over is None:
        return []
    masks = (over.values != Tissue.AIR, np.isin(over.values, list(tissues)))
    return [(over, [line for mask in masks for line in contours(mask)])]


def _panel(
    cut: Section,
    frame: tuple[float, float, float, float],
    view: View,
    differs: bool,
    plates: Sequence[tuple[tuple[float, float], tuple[float, float]]],
    outlines: Sequence[tuple[Section, list[Contour]]],
) -> Svg:
    """Draw one section in a frame in mm, with ticks along its lower and left edge."""
    left, right, bottom, top = frame
    x0, y0 = 34.0, 6.0
    wide = PANEL_PX - x0 - 4
    high = wide * (top - bottom) / (right - left)
    svg = Svg(PANEL_PX, y0 + high + 34)
    across, up = Scale(left, right, x0, x0 + wide), Scale(bottom, top, y0 + high, y0)
    shown = clipped(cut, frame)
    a, b, c, d = shown.extent_mm
    svg.add(
        "image",
        href=png_uri(shown.values, DIFFERENCE_COLOURS if differs else TISSUE_COLOURS),
        preserveAspectRatio="none",
        # Voxels smaller than pixels are averaged, to avoid holes in thin skin.
        class_="voxels" if shown.values.shape[1] <= across.at(b) - across.at(a) else "small",
        x=across.at(a),
        y=up.at(d),
        width=across.at(b) - across.at(a),
        height=up.at(c) - up.at(d),
    )
    panel = Panel(frame, x0, y0, wide / (right - left))
    for section_of, lines in outlines:
        panel.lines(svg, lines, section_of.spacing_mm, section_of.origin_mm)
    for (x1, y1), (x2, y2) in plates:
        line = f"M{across.at(x1):.1f} {up.at(y1):.1f}L{across.at(x2):.1f} {up.at(y2):.1f}"
        svg.add("path", d=line, class_="plate")
    for value in across.ticks(4):
        x = across.at(value)
        svg.add("path", d=f"M{x:.1f} {y0 + high:.1f}v3", class_="axis")
        svg.text(x, y0 + high + 14, tick_text(value), text_anchor="middle", class_="tick")
    for value in up.ticks(4):
        y = up.at(value)
        svg.add("path", d=f"M{x0:.1f} {y:.1f}h-3", class_="axis")
        svg.text(x0 - 6, y + 4, tick_text(value), text_anchor="end", class_="tick")
    svg.add("path", d=f"M{x0:.1f} {y0:.1f}V{y0 + high:.1f}H{x0 + wide:.1f}", class_="axis")
    label = f"{AXES[view.across]} and {AXES[view.up]}, mm"
    svg.text(x0 + wide / 2, y0 + high + 29, label, text_anchor="middle", class_="tick")
    return svg
