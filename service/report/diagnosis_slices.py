"""Sections through observed and predicted bodies, and through the map of causes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from service.diagnosis.words import signed
from service.report.canvas import SMALL_PT, TEXT_PT, calm, figure
from service.report.diagnosis_maps import SIGNIFICANT, sharpened
from service.report.palette import BLUE, INK, SOFT_INK, VERMILION
from service.report.slices import AXES, VIEWS, Section, View, frame_mm, section
from storage.values import Tissue, Triple, Volume

WIDTH_IN = 10.4
# What the words beside and below a section need, across and up.
LABELS_IN = (0.6, 0.72)
# One column of sections is no wider, and no figure higher, lest it fill a screen.
MOST_IN = (5.9, 6.0)
BODY, GLAND, QUIET = "#8a94a12e", "#8a94a180", "#8a94a170"
# Hues that mean neither "outside" nor "inside".
CAUSES = LinearSegmentedColormap.from_list(
    "causes", ["#0b4f3c", "#1b8a6b", "#a3cfc0", "#d0ccc8", "#d0a3c6", "#9b3a86", "#521047"]
)
SMALLEST_SCORE = 4.0


def overlays(observed: Volume, predicted: Mapping[str, Volume], middle: Triple) -> Figure:
    """Return what the model has too much and too little, in three sections of one scan.

    Parameters
    ----------
    observed : Volume
        `Tissue` labels.
    predicted : mapping of str to Volume
        On the lattice of `observed`, by the title of their column.
    middle : tuple of float
        Point (x, y, z) in mm that the sections pass through.
    """
    cuts = [(v, section(observed, v, middle[v.normal])) for v in VIEWS]
    frames = [frame_mm([seen]) for _, seen in cuts]
    columns = len(predicted)
    drawn, grid = _grid(frames, columns, 0.3)
    for line, (view, seen), box in zip(grid, cuts, frames, strict=True):
        for axes, volume in zip(line, predicted.values(), strict=True):
            model = section(volume, view, middle[view.normal])
            axes.imshow(
                compared(seen, model), origin="lower", extent=seen.extent_mm, interpolation="none"
            )
            for tissue_set in (_body(seen), _gland(seen)):
                _contour(axes, seen, tissue_set, 0.4)
            _dress(axes, view, box, middle)
    _head(grid[0], predicted)
    return drawn


def overlay_legend() -> list[tuple[str, str]]:
    """(colour, meaning) of the colours of an overlay."""
    return [
        (VERMILION, "model outside: predicted, not in the scan"),
        (BLUE, "model inside: in the scan, not predicted"),
        (GLAND, "glandular tissue in both"),
        (BODY, "other tissue in both"),
    ]


def compared(seen: Section, model: Section) -> NDArray[np.float64]:
    """Return colours of a section, shape (rows, columns, 4), clear where there is air.

    Too much of the body or of its glandular tissue is vermilion, too little blue. The
    sections must have one box.
    """
    pixels = np.zeros((*seen.values.shape, 4))
    pixels[_body(seen)] = to_rgba(BODY)
    pixels[_gland(seen) & _gland(model)] = to_rgba(GLAND)
    # Tissue that is missing altogether is also missing gland: the outline is drawn last.
    for of in (_gland, _body):
        pixels[of(model) & ~of(seen)] = to_rgba(VERMILION)
        pixels[of(seen) & ~of(model)] = to_rgba(BLUE)
    return pixels


def cause_sections(
    maps: Mapping[str, Volume], body: Volume, at: Triple, reached_by_noise: float
) -> Figure:
    """Return scores of "locally stiffer" in three sections, a column for each map.

    Parameters
    ----------
    maps : mapping of str to Volume
        Scores on one lattice by the title of their column; nan where the scans tell nothing.
    body : Volume
        `Tissue` labels of the body at rest.
    at : tuple of float
        Point (x, y, z) in mm that the sections pass through.
    reached_by_noise : float
        Level that noise alone exceeds somewhere in 5 of 100 cases; marked in the scale.
    """
    cuts = [(v, section(body, v, at[v.normal])) for v in VIEWS]
    frames = [frame_mm([seen]) for _, seen in cuts]
    drawn, grid = _grid(frames, len(maps), 1.0)
    loudest = max(float(np.nanmax(np.abs(m.values), initial=0.0)) for m in maps.values())
    scale = Normalize(-max(SMALLEST_SCORE, loudest), max(SMALLEST_SCORE, loudest))
    for line, (view, seen), box in zip(grid, cuts, frames, strict=True):
        for axes, scores in zip(line, maps.values(), strict=True):
            plane, extent = _plane(scores, view, at[view.normal])
            axes.imshow(_scored(plane, scale), origin="lower", extent=extent, interpolation="none")
            for tissue_set in (_body(seen), _gland(seen)):
                _contour(axes, seen, tissue_set, 0.5)
            axes.plot(at[view.across], at[view.up], marker="+", color=INK, markersize=7)
            _dress(axes, view, box, at)
    _head(grid[0], maps)
    bar = drawn.colorbar(ScalarMappable(scale, CAUSES), ax=grid, aspect=32, pad=0.01, panchor=False)
    bar.set_label(
        "score: softer (−) or stiffer (+) tissue explains it", fontsize=SMALL_PT, color=INK
    )
    for level in (-reached_by_noise, reached_by_noise):
        bar.ax.axhline(level, color=INK, linewidth=1.0)
    bar.ax.tick_params(labelsize=SMALL_PT, colors=SOFT_INK)
    bar.outline.set_visible(False)
    return drawn


def _scored(plane: NDArray[np.float32], scale: Normalize) -> NDArray[np.float64]:
    """Return colours of scores: grey where they are small, clear where nothing is known."""
    pixels = np.asarray(CAUSES(scale(np.nan_to_num(plane))))
    pixels[np.abs(np.nan_to_num(plane)) < SIGNIFICANT] = to_rgba(QUIET)
    pixels[np.isnan(plane)] = 0.0
    return pixels


def _plane(
    scores: Volume, view: View, at_mm: float
) -> tuple[NDArray[np.float32], tuple[float, float, float, float]]:
    """Return the plane of a map nearest to a place, and its edges."""
    nearest = round((at_mm - scores.origin_mm[view.normal]) / scores.spacing_mm[view.normal])
    axis = 2 - view.normal
    plane = np.take(scores.values, min(max(nearest, 0), scores.values.shape[axis] - 1), axis=axis)
    if view.up < view.across:
        plane = plane.T
    rows, columns = plane.shape
    dx, dy = scores.spacing_mm[view.across], scores.spacing_mm[view.up]
    x, y = scores.origin_mm[view.across] - dx / 2, scores.origin_mm[view.up] - dy / 2
    return plane, (x, x + columns * dx, y, y + rows * dy)


def _grid(
    frames: Sequence[tuple[float, float, float, float]], columns: int, beside_in: float
) -> tuple[Figure, NDArray[np.object_]]:
    """Return a figure with a row for each frame; one scale for all, as large as the page allows."""
    widest = max(right - left for left, right, _, _ in frames)
    heights = [top - bottom for _, _, bottom, top in frames]
    room = (WIDTH_IN - beside_in) / columns - LABELS_IN[0]
    per_mm = min(room / widest, MOST_IN[0] / widest, MOST_IN[1] / sum(heights))
    width = per_mm * widest + LABELS_IN[0]
    drawn = figure(columns * width + beside_in, per_mm * sum(heights) + LABELS_IN[1] * len(frames))
    sharpened(drawn)
    return drawn, drawn.subplots(len(frames), columns, squeeze=False, height_ratios=heights)


def _dress(axes: Axes, view: View, box: tuple[float, float, float, float], at: Triple) -> None:
    left, right, bottom, top = box
    calm(axes, grid="")
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", anchor="W")
    where = f"{view.name}, {AXES[view.normal]} = {signed(at[view.normal], 0)} mm"
    axes.set_title(where, fontsize=SMALL_PT, color=SOFT_INK, loc="left", pad=3)
    axes.set_xlabel(f"{AXES[view.across]}, mm", fontsize=SMALL_PT)
    axes.set_ylabel(f"{AXES[view.up]}, mm", fontsize=SMALL_PT)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4))


def _head(line: Sequence[Axes], titles: Iterable[str]) -> None:
    """Return titles of the columns, above those of their first sections."""
    for axes, title in zip(line, titles, strict=True):
        axes.annotate(
            title,
            (0, 1),
            (0, 17),
            xycoords="axes fraction",
            color=INK,
            textcoords="offset points",
            fontsize=TEXT_PT,
        )


def _contour(axes: Axes, shown: Section, inside: NDArray[np.bool_], width: float) -> None:
    if not inside.any() or inside.all():
        return
    (dx, dy), (x, y) = shown.spacing_mm, shown.origin_mm
    rows, columns = inside.shape
    drawn = axes.contour(
        x + dx * np.arange(columns),
        y + dy * np.arange(rows),
        inside.astype(float),
        [0.5],
        colors=[SOFT_INK],
        linewidths=width,
    )
    drawn.set_rasterized(True)


def _body(shown: Section) -> NDArray[np.bool_]:
    return np.asarray(shown.values != Tissue.AIR)


def _gland(shown: Section) -> NDArray[np.bool_]:
    return np.asarray(shown.values == Tissue.GLANDULAR)


def titled(maps: Mapping[str, object], accused: str) -> Iterator[tuple[str, str]]:
    """(key, title) of "before" and "after", as far as they are there."""
    for key, title in (("before", "nominal model"), ("after", f"with {accused}")):
        if key in maps:
            yield key, title
