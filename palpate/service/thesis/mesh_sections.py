"""Slices of tetrahedral meshes, drawn below each other (thesis Fig. 4.14)."""

from collections.abc import Sequence

import numpy as np

from palpate.service.report.drawing.palette import INK, TISSUES
from palpate.service.report.drawing.svg import Svg
from palpate.storage.values import BoolArray, FloatArray, Tissue

WIDTH_PX, TITLE_PX = 980.0, 24.0

MeshSlice = tuple[str, FloatArray, BoolArray]
"""A title, polygons (m, 4, 2) in mm, to the right and upwards, and a mask of glandular ones."""


def mesh_sections(shown: Sequence[MeshSlice]) -> Svg:
    """Draw slices at one scale, with all polygons of a tissue in one element."""
    places = np.concatenate([polygons.reshape(-1, 2) for _, polygons, _ in shown])
    low, high = places.min(axis=0), places.max(axis=0)
    per_mm = (WIDTH_PX - 2) / float(high[0] - low[0])
    tall = per_mm * float(high[1] - low[1]) + TITLE_PX
    drawn = Svg(WIDTH_PX, len(shown) * tall)
    for n, (title, polygons, glandular) in enumerate(shown):
        drawn.text(0, n * tall + 0.6 * TITLE_PX, title, class_="strong")
        at = np.stack(
            [
                1 + per_mm * (polygons[..., 0] - low[0]),
                (n + 1) * tall - 1 - per_mm * (polygons[..., 1] - low[1]),
            ],
            axis=-1,
        )
        for tissue, chosen in ((Tissue.FAT, ~glandular), (Tissue.GLANDULAR, glandular)):
            drawn.add(
                "path",
                d=_outlines(at[chosen]),
                transform="scale(0.1)",
                fill=TISSUES[tissue],
                stroke=INK,
                stroke_width=3,
            )
    return drawn


def _outlines(polygons: FloatArray) -> str:
    """Return polygons as a path of corner-to-corner steps in tenths of pixels."""
    tenths = np.rint(10 * polygons).astype(np.int64)
    steps = np.diff(tenths, axis=1)
    written = []
    for (x, y), moves in zip(tenths[:, 0].tolist(), steps.tolist(), strict=True):
        lines = " ".join(f"{dx} {dy}" for dx, dy in moves if dx or dy)
        if lines:
            written.append(f"M{x} {y}l{lines}z")
    return "".join(written).replace(" -", "-")
