"""A preview of an imported image: a table of facts, and three slices."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.service.report.drawing.colours import INK, TISSUE_PALETTE
from palpate.service.report.drawing.volume_sections import (
    AXES,
    VIEWS,
    Section,
    View,
    middle_mm,
    section,
)
from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.scan_orientation import end_areas_mm2, opposite, world_axes

MEANING = {
    "x": "across the compression",
    "y": "direction of compression",
    "z": "chest wall to nipple",
}
DIRECTIONS = {
    "L": "left",
    "R": "right",
    "P": "posterior",
    "A": "anterior",
    "S": "superior",
    "I": "inferior",
}
# The plane that is perpendicular to a direction.
PLANES = {
    "L": "sagittal",
    "R": "sagittal",
    "P": "coronal",
    "A": "coronal",
    "S": "transverse",
    "I": "transverse",
}
# For terminals without colours.
LETTERS = {
    Tissue.AIR: " ",
    Tissue.FAT: ".",
    Tissue.GLANDULAR: "#",
    Tissue.SKIN: "s",
    Tissue.MUSCLE: "m",
    Tissue.LIGAMENT: "l",
}
WIDEST_PANEL, GAP = 34, 2


def facts(summary: Mapping[str, Any], axes: str | None) -> list[tuple[str, str]]:
    """Return the names and texts of the facts about an imported image.

    Parameters
    ----------
    summary : mapping
        See `workers.body.images.tissue_labels.summarise`; with the additions of `palpate import`.
    axes : str or None
        As given by the user.
    """
    rows = [
        ("voxels", " x ".join(str(n) for n in summary["shape"])),
        ("spacing", " x ".join(f"{s:g}" for s in summary["spacing_mm"]) + " mm"),
    ]
    if summary.get("slices"):
        first, last = summary["slices"]
        rows.append(("slices", f"from {first} to {last}"))
    if "place_known" in summary:
        rows.append(("place", _place(summary)))
    rows += _extents(summary, axes)
    rows += _understood(summary)
    labels = [label for number, label in summary["labels"].items() if int(number)]
    whole = sum(label["ml"] for label in labels)
    for label in labels:
        share = 100 * label["ml"] / max(whole, 1e-12)
        rows.append((str(label.get("tissue", "?")), f"{label['ml']:.4g} ml, {share:.3g} %"))
    rows.append(("total", f"{whole:.4g} ml"))
    return rows


def _place(summary: Mapping[str, Any]) -> str:
    if not summary["place_known"]:
        return "unknown: the file does not give the position of its voxels"
    frame = summary.get("frame_uid")
    return "as given by the file" + (f", frame of reference {frame}" if frame else "")


def _extents(summary: Mapping[str, Any], axes: str | None) -> list[tuple[str, str]]:
    world = world_axes(axes)
    letters = summary.get("increasing_towards")
    body = summary["body_mm"] or summary["box_mm"]
    rows = []
    for k, axis in enumerate(AXES):
        low, high = body["lower"][k], body["upper"][k]
        # Of anatomical axes x increases to the left, y to posterior, whatever the file's own do.
        towards = f"towards {DIRECTIONS[letters[k]]}" if letters else f"{world[k]} of the image"
        text = f"{high - low:.4g} mm, from {low:.4g} to {high:.4g}; {towards}"
        rows.append((f"body {axis}", f"{text}: {MEANING[axis]}"))
    return rows


def _understood(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the tissue assigned to each label of the file, with its name if it has one."""
    names, tissues = summary.get("label_names") or {}, summary.get("label_tissues") or {}
    named = {k: f"{names[k]}: {t}" if k in names else t for k, t in tissues.items()}
    return [(f"label {k}", text) for k, text in named.items() if k in names or int(k)]


def doubt(volume: Volume, letters: tuple[str, str, str] | None = None) -> str:
    """Return a warning about implausible axes; empty if there is none.

    The direction from the chest wall to the nipple is anterior, and a breast is widest at the chest
    wall, the low end of z.

    Parameters
    ----------
    volume : Volume
    letters : tuple of str, optional
        Anatomical directions in which x, y and z increase, if the file gives them.
    """
    if letters is not None and letters[2] != "A":
        return (
            f"z increases towards {letters[2]}, but the direction from chest wall to nipple is "
            f"anterior. Give --axes with A as the third letter, such as 'L S A' for a "
            f"cranio-caudal compression."
        )
    wall, nipple = end_areas_mm2(volume)
    if wall >= nipple:
        return ""
    return (
        f"The body is wider at the high end of z ({nipple / 100:.3g} cm2) than at the low "
        f"end ({wall / 100:.3g} cm2), where the chest wall should be. If z does not run from "
        "chest wall to nipple, give --axes, such as -x,y,-z."
    )


def slices(volume: Volume) -> list[tuple[View, float, Section]]:
    """Return a section along each axis through the middle of the glandular tissue."""
    middle = middle_mm(volume, [Tissue.GLANDULAR])
    return [(v, middle[v.normal], section(volume, v, middle[v.normal])) for v in VIEWS]


def write_png(
    path: Path, volume: Volume, title: str, letters: tuple[str, str, str] | None = None
) -> None:
    """Draw three slices with their axes in mm.

    Parameters
    ----------
    path : Path
    volume : Volume
    title : str
    letters : tuple of str, optional
        Anatomical directions in which x, y and z increase; drawn at the edges.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    drawn = Figure(figsize=(11, 4.2), layout="constrained", facecolor="white")
    FigureCanvasAgg(drawn)
    colours = ListedColormap([TISSUE_PALETTE[t] for t in Tissue])
    for panel, (view, at_mm, cut) in zip(drawn.subplots(1, 3), slices(volume), strict=True):
        panel.imshow(
            cut.values,
            cmap=colours,
            vmin=-0.5,
            vmax=len(Tissue) - 0.5,
            origin="lower",
            extent=cut.extent_mm,
            interpolation="nearest",
        )
        panel.set_xlabel(f"{AXES[view.across]} (mm): {MEANING[AXES[view.across]]}", color=INK)
        panel.set_ylabel(f"{AXES[view.up]} (mm): {MEANING[AXES[view.up]]}", color=INK)
        panel.set_title(f"{_plane(view, letters)}, {AXES[view.normal]} = {at_mm:.3g} mm", color=INK)
        if letters:
            _write_letters(panel, letters[view.across], letters[view.up])
    there = [t for t in Tissue if t and (np.asarray(volume.values) == t).any()]
    patches = [
        Patch(facecolor=TISSUE_PALETTE[t], edgecolor=INK, label=t.name.lower()) for t in there
    ]
    drawn.legend(handles=patches, loc="outside lower center", ncols=len(there), frameon=False)
    drawn.suptitle(title, color=INK)
    with explained(path), replacing(path) as temporary:
        drawn.savefig(temporary, format="png", dpi=110, metadata={"Software": None})


def _write_letters(panel: Any, across: str, up: str) -> None:
    """Write the anatomical directions at the four edges of a slice."""
    edges = ((0.98, 0.5, across), (0.02, 0.5, opposite(across)))
    ends = ((0.5, 0.97, up), (0.5, 0.03, opposite(up)))
    for x, y, letter in (*edges, *ends):
        panel.text(
            x,
            y,
            letter,
            transform=panel.transAxes,
            ha="center",
            va="center",
            weight="bold",
            color=INK,
            bbox={"boxstyle": "circle", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )


def _plane(view: View, letters: Sequence[str] | None) -> str:
    """Return the anatomical name of a plane; that of the view if directions are unknown."""
    return PLANES[letters[view.normal]] if letters else view.name


def terminal_lines(
    volume: Volume, width: int, *, colours: bool, letters: Sequence[str] | None = None
) -> Iterator[Any]:
    """Yield the three slices as lines for a `rich` console, side by side or one below the other.

    Parameters
    ----------
    volume : Volume
    width : int
        Columns of the terminal.
    colours : bool
        Draw half blocks, two pixels per character; otherwise a letter for each tissue.
    letters : sequence of str, optional
        Anatomical directions in which x, y and z increase.
    """
    from rich.text import Text

    shown = slices(volume)
    beside = width >= 3 * 20 + 2 * GAP
    panel = min(WIDEST_PANEL, (width - 2 * GAP) // 3 if beside else width)
    largest = max(_size_mm(cut)[0] for _, _, cut in shown)
    blocks = []
    for view, at_mm, cut in shown:
        columns = max(2, round(panel * _size_mm(cut)[0] / largest))
        title = Text(
            f"{_plane(view, letters)}, {AXES[view.normal]} {at_mm:.3g} mm"[:panel].ljust(panel)
        )
        blocks.append([title, *_drawn(cut, columns, panel, colours)])
    if not beside:
        for block in blocks:
            yield from block
    else:
        for row in range(max(map(len, blocks))):
            cells = [b[row] if row < len(b) else Text(" " * panel) for b in blocks]
            yield Text(" " * GAP).join(cells)
    yield _legend(volume, colours)


def _drawn(cut: Section, columns: int, panel: int, colours: bool) -> Iterator[Any]:
    """Yield the lines of one slice, two rows of square pixels per line."""
    from rich.text import Text

    wide, high = _size_mm(cut)
    lines = max(1, round(columns * high / wide / 2))
    pixels = _resampled(cut, 2 * lines, columns)[::-1]  # the first line is the top
    for k in range(lines):
        upper, lower = pixels[2 * k], pixels[2 * k + 1]
        line = Text()
        for above, below in zip(upper, lower, strict=True):
            if not colours:
                line.append(LETTERS.get(Tissue(int(below or above)), "?"))
            elif not above and not below:
                line.append(" ")
            elif not below:
                line.append("▀", style=_colour(above))
            elif not above:
                line.append("▄", style=_colour(below))
            else:
                line.append("▀", style=f"{_colour(above)} on {_colour(below)}")
        line.append(" " * (panel - columns))
        yield line


def _legend(volume: Volume, colours: bool) -> Any:
    from rich.text import Text

    line = Text()
    for tissue in Tissue:
        if tissue and (np.asarray(volume.values) == tissue).any():
            mark = "██" if colours else LETTERS[tissue]
            line.append(mark, style=_colour(tissue) if colours else "")
            line.append(f" {tissue.name.lower()}  ")
    return line


def _colour(tissue: int) -> str:
    return TISSUE_PALETTE[Tissue(int(tissue))]


def _resampled(cut: Section, rows: int, columns: int) -> NDArray[np.uint8]:
    """Return the labels at the pixel centres of a grid, row 0 at the bottom."""
    have = cut.values.shape
    i = ((np.arange(rows) + 0.5) * have[0] / rows).astype(np.intp)
    j = ((np.arange(columns) + 0.5) * have[1] / columns).astype(np.intp)
    return np.asarray(cut.values[np.ix_(i, j)])


def _size_mm(cut: Section) -> tuple[float, float]:
    left, right, bottom, top = cut.extent_mm
    return right - left, top - bottom
