"""Elements of a page: templates filled in, a glossary, drawings, packed arrays, what may be quoted.

Templates, style sheet and scripts are beside this module. Drawings have alternative texts and
captions. Drawings and arrays put JSON into the page for its scripts: the numbers of a drawing, to
be saved as CSV, and arrays as base64 of a zlib stream, with large volumes subsampled.
"""

import base64
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from palpate.service.number_formatting import joined
from palpate.service.report.drawing.svg import Svg
from palpate.service.results.quotability_rule import Quotability, names_by_reason, repeated
from palpate.storage.values import Triple, Volume

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = Path(__file__).parent


def filled(template: str, values: Mapping[str, Any], folder: Path = TEMPLATES) -> str:
    """Return the page as text; equal values give the same bytes.

    Parameters
    ----------
    template : str
        Name of the file in `folder`; included files may also be in this folder.
    values : mapping of str to Any
        Values of all names in the template.
    folder : Path
    """
    return _environment(folder).get_template(template).render(values)


@cache
def _environment(folder: Path) -> Environment:
    """Return the template environment, which caches compiled templates."""
    return Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )


STUDY_TERMS = (
    ("Candidate", "One proposal of the search: a value for every searched constant."),
    ("Generation", "The candidates proposed together, counted from 1."),
    ("Elite", "The best candidates of a generation, kept unchanged in the next."),
    ("Target", "The deformed body that the simulation should match."),
    (
        "E, η",
        "Young's modulus and fibre stiffness: how strongly a tissue resists, in all directions "
        "and along its fibres.",
    ),
    (
        "Jaccard (JC)",
        "Volume of the intersection of two bodies, divided by the volume of their union: 1 if "
        "equal.",
    ),
    ("Dice", "Twice the volume of the intersection, divided by the sum of both volumes."),
    (
        "MHD",
        "Modified Hausdorff distance: the mean distance between two surfaces, the larger of the "
        "two directions.",
    ),
    ("GSF", "ln((1 − Jaccard) · MHD in voxels); lower is better."),
    (
        "Weakly determined",
        "The interval is wider than half the value: other values explain the images almost as "
        "well.",
    ),
)

DIAGNOSIS_TERMS = (
    ("Gap", "Root mean square difference of model and data beyond the noise, in mm."),
    (
        "Noise",
        "Standard deviation of the error of the segmentation, or of a marker's recording, at one "
        "point.",
    ),
    ("Nominal model", "The model without any suspected effect, with fitted constants."),
    ("Effect", "A cause missing from the model, with a magnitude that can be fitted."),
    (
        "Gain, nats",
        "How much better a model predicts the data than the nominal one (increase in log "
        "evidence), less a price for each parameter that its fit adjusts.",
    ),
    (
        "Evidence",
        "The gain in a word: none up to 5 nats, faint to 10, weak to 20, clear to 50, then strong.",
    ),
    ("Seen from", "The size from which these data would have shown an effect."),
    (
        "Absorbed by constants",
        "The part of an effect that other constants could mimic; if it is large, the effect is "
        "neither confirmed nor ruled out.",
    ),
    ("On unseen scans", "Each scan is compared with a fit to the others."),
)
# For scans; a bench has no overlap.
OVERLAP_TERMS = (
    ("JC, MHD, GSF", "Jaccard coefficient, modified Hausdorff distance, and ln((1 − JC) · MHD)."),
)


TableRow = Sequence[str | float | None]
SCREEN_DPI = 96
# Widths in pixels of the two forms of a chart; the style sheet selects the one that fits.
WIDE_PX, NARROW_PX = 980.0, 400.0


@dataclass(frozen=True)
class Picture:
    """A drawing in the page.

    Parameters
    ----------
    svg : Markup
    alt : str
        Alternative text.
    width_px : int
    caption : str or Markup
    table : str or Markup
        Its numbers, for saving as CSV; see `table_of`.
    """

    svg: Markup
    alt: str
    width_px: int
    caption: str | Markup = ""
    table: str | Markup = ""


def picture(
    drawn: "Figure", alt: str, caption: str | Markup = "", *, on_paper: bool = False
) -> Picture:
    """Return a matplotlib figure as a picture; see `matplotlib_figures.inline_svg`."""
    # Loads matplotlib, which most pages do not need.
    from palpate.service.report.drawing.matplotlib_figures import inline_svg

    width = round(SCREEN_DPI * drawn.get_figwidth())
    return Picture(inline_svg(drawn, alt, width, on_paper=on_paper), alt, width, caption)


def chart(
    draw: Callable[[float], Svg],
    alt: str,
    caption: str | Markup = "",
    rows: Sequence[TableRow] = (),
    **data: str,
) -> Picture:
    """Draw a chart twice, for wide and narrow pages; `rows` are its numbers, header first."""
    both = draw(WIDE_PX).markup(alt, "wide", **data) + draw(NARROW_PX).markup(alt, "narrow", **data)
    return Picture(both, alt, round(WIDE_PX), caption, table_of(rows))


def small_chart(drawn: Svg, alt: str, caption: str | Markup = "", **data: str) -> Picture:
    """Return a chart that is drawn once, for wide and narrow pages."""
    return Picture(drawn.markup(alt, **data), alt, round(drawn.width), caption)


def table_of(rows: Sequence[TableRow]) -> Markup:
    """Return rows as an element for the page's script; empty if there are none."""
    if not rows:
        return Markup("")
    plain = [[None if _is_unknown(cell) else cell for cell in row] for row in rows]
    text = json.dumps(plain, ensure_ascii=False, allow_nan=False).replace("</", "<\\/")
    return (
        Markup('<script type="application/json" class="table">')
        + Markup(text)
        + Markup("</script>")
    )


def _is_unknown(cell: object) -> bool:
    return isinstance(cell, float) and not math.isfinite(cell)


# Larger volumes are subsampled: four million labels take about 300 kB in a page.
MOST_VOXELS = 6_000_000
TYPES: dict[str, np.dtype[Any]] = {
    "u1": np.dtype("u1"),
    "u2": np.dtype("<u2"),
    "u4": np.dtype("<u4"),
    "f4": np.dtype("<f4"),
}

Json = dict[str, Any]


def packed(values: NDArray[Any], kind: str) -> Json:
    """Return an array for the script's `unpack`: base64 of a zlib stream.

    Parameters
    ----------
    values : ndarray
        Of any shape; the script receives it flat.
    kind : {"u1", "u2", "u4", "f4"}
    """
    raw = np.ascontiguousarray(values, TYPES[kind]).tobytes()
    # Labels are long runs: searching only for runs takes a tenth of the time and gives a seventh
    # more bytes.
    strategy = zlib.Z_RLE if kind == "u1" else zlib.Z_DEFAULT_STRATEGY
    stream = zlib.compressobj(9, strategy=strategy)
    data = stream.compress(raw) + stream.flush()
    return {"type": kind, "data": base64.b64encode(data).decode()}


def packed_triangles(triangles: NDArray[np.integer]) -> Json:
    """Return triangles in the smallest integer type for their number of vertices."""
    return packed(triangles, "u2" if triangles.max(initial=0) < 2**16 else "u4")


def packed_points(points: NDArray[np.floating]) -> Json:
    """Return points rounded to 0.01 mm, which compresses better."""
    return packed(np.round(points, 2), "f4")


def packed_volume(volume: Volume, most: int = MOST_VOXELS) -> Json:
    """Return a label volume, subsampled if it is too large for a page.

    Parameters
    ----------
    volume : Volume
        Labels up to 255.
    most : int
        Voxels.
    """
    thin = thinned(volume, most)
    return {
        "shape": list(thin.shape_xyz),
        "spacing": list(thin.spacing_mm),
        "origin": list(thin.origin_mm),
        "labels": packed(thin.values, "u1"),
    }


def thinned(volume: Volume, most: int = MOST_VOXELS) -> Volume:
    """Return every nth voxel along each axis, for at most `most` voxels."""
    step = 1
    while np.prod([-(-n // step) for n in volume.values.shape]) > most:
        step += 1
    if step == 1:
        return volume
    dx, dy, dz = volume.spacing_mm
    spacing: Triple = (step * dx, step * dy, step * dz)
    values = volume.values[::step, ::step, ::step]
    return replace(volume, values=values, spacing_mm=spacing)


def body_box_mm(volume: Volume) -> tuple[Triple, Triple]:
    """Return the lowest and highest corners of the body's box, (x, y, z) in mm."""
    low, high = [], []
    solid = volume.values != 0
    for axis in range(3):
        there = np.flatnonzero(solid.any(axis=tuple(a for a in range(3) if a != 2 - axis)))
        first, last = (there[0], there[-1]) if there.size else (0, solid.shape[2 - axis] - 1)
        step, origin = volume.spacing_mm[axis], volume.origin_mm[axis]
        low.append(float(origin + (first - 0.5) * step))
        high.append(float(origin + (last + 0.5) * step))
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def script(name: str, told: Mapping[str, Any]) -> Markup:
    """Return data as a page element that the script finds by name."""
    text = json.dumps(told, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    head = Markup('<script type="application/json" id="{}-data">').format(name)
    return head + Markup(text.replace("</", "<\\/")) + Markup("</script>")


def quote_lines(quote: Markup, answers: Mapping[Markup, Quotability]) -> Markup:
    """Return what to quote, and what not: a sentence, or a line for each of several reasons.

    Parameters
    ----------
    quote : Markup
        The values that may be quoted, as ``Quote E = 10 kPa``; empty if there are none.
    answers : mapping of Markup to Quotability
        All values by name.
    """
    groups = names_by_reason(answers)
    bad = [
        (joined([Markup("{} ({})").format(n, end) if end else n for n, end in names]), reason)
        for names, reason in groups
    ]
    if len(bad) == 1:
        start = quote + Markup("; do not quote") if quote else Markup("Do not quote")
        return Markup("{} {} ({}).").format(start, *bad[0])
    lines = [quote + Markup(".")] if quote else []
    starts = ("Of these" if repeats else "Do not quote" for repeats in repeated(groups))
    lines += [
        Markup("{} {}: {}.").format(start, *one) for start, one in zip(starts, bad, strict=True)
    ]
    return Markup("<br>\n").join(lines)
