"""Animate the demo: a breast between two plates, coloured by the gap to the imaged body.

::

    palpate run examples/demo.yaml
    python docs/pictures/animate.py runs/demo docs/pictures/breast.gif

First the plates close on the body with the constants of the first candidate; then come the
candidates that were better than all before them, and the gap closes. Every frame is a
simulation of the study's own body.
"""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from palpate.service.export.solved_mesh_files import solve_body  # noqa: E402
from palpate.service.report.drawing.colours import SIGNED, ColourScale  # noqa: E402
from palpate.service.report.drawing.raster import NO_TRIANGLE, front_triangles  # noqa: E402
from palpate.service.report.study.study_data import read_study_data, study_surfaces  # noqa: E402
from palpate.service.study.study_folder import read_study  # noqa: E402
from palpate.service.study.study_keys import read_spec  # noqa: E402
from palpate.storage.backends.store_paths import StudyLayout  # noqa: E402
from palpate.storage.journal_records import EvaluationRecord  # noqa: E402
from palpate.storage.values import FloatArray, IntArray  # noqa: E402

WIDTH, HEIGHT, SMOOTH = 720, 400, 2
BACKGROUND, INK, PLATE = (255, 255, 255), (40, 40, 40), (120, 130, 140)
# Share of the force in the frames in which the plates close.
CLOSING = (0.0, 0.1, 0.25, 0.45, 0.7, 1.0)
GAP_END_MM = 3.0
# Candidates that are shown.
MOST = 10
MS, LAST_MS = 350, 3000
COLOURS = 160
# How far plates are drawn above the surface, and beyond the nipple.
CLEAR_MM, BEYOND_MM = 1.0, 12.0


@dataclass(frozen=True)
class Frame:
    """One picture: the moved outline, its gap, the plates, and a caption."""

    moved: FloatArray
    triangles: IntArray
    gap_mm: FloatArray
    plates_mm: tuple[float, float]
    caption: tuple[str, str]


def frames(folder: Path) -> list[Frame]:
    """Simulate the body under the best candidate of every generation."""
    spec, (_, log) = read_spec(StudyLayout(folder).study), read_study(folder)
    bodies = read_study_data(folder).bodies
    case, store = spec.case.model_dump(mode="json"), log.sessions[-1].store
    full_n = case["load"]["force_n"]

    def frame(genes: dict[str, float], share: float, title: str) -> Frame:
        load = {**case["load"], "force_n": max(full_n * share, 0.5)}
        solved = solve_body({**case, "load": load}, spec.constants_of(genes), store, spec.name)
        mesh = solved.setup.mesh.finest.mesh
        outline, *_ = study_surfaces(bodies.reference, mesh, solved.displacement_mm, bodies.target)
        assert outline.moved is not None and outline.gap_mm is not None
        gap = outline.gap_mm if share == 1 else np.full_like(outline.gap_mm, np.nan)
        rms = float(np.sqrt(np.nanmean(gap**2))) if share == 1 else 0.0
        fat, gland = genes["E_fat_kpa"], genes["E_glandular_kpa"]
        young = f"E fat {fat:.1f} kPa, E gland {gland:.1f} kPa"
        left = f"{young}: gap {rms:.2f} mm" if share == 1 else f"{full_n * share:.0f} N"
        y = outline.moved[:, 1]
        return Frame(outline.moved, outline.triangles, gap, (y.min(), y.max()), (title, left))

    best = improvements(log.endings.values())
    pictures = [frame(best[0][1], share, "the plates close") for share in CLOSING[:-1]]
    return pictures + [frame(genes, 1.0, title) for title, genes in best]


def improvements(endings: Iterable[EvaluationRecord]) -> list[tuple[str, dict[str, float]]]:
    """Return the candidates that were better than all before them, at most `MOST` of them."""
    best, lowest = [], np.inf
    for record in sorted(endings, key=lambda one: one.candidate):
        if record.score is None or record.level is not None or record.score["gsf"] >= lowest:
            continue
        lowest = record.score["gsf"]
        how = "least squares" if record.fit is not None else f"generation {record.generation + 1}"
        best.append((f"{how}, candidate {record.candidate}", dict(record.genes)))
    kept = np.unique(np.linspace(0, len(best) - 1, MOST).astype(int))
    return [best[number] for number in kept]


def draw(picture: Frame, everything: list[Frame]) -> Image.Image:
    """Draw the outline from the side: z to the right, the direction of compression upwards."""
    wide, high = WIDTH * SMOOTH, HEIGHT * SMOOTH
    turn = np.deg2rad(32.0)
    away, across, up = _view(turn)
    all_points = np.concatenate([one.moved for one in everything])
    flat = np.column_stack([all_points @ across, all_points @ up])
    low, size = flat.min(axis=0), np.ptp(flat, axis=0)
    scale = min(0.80 * wide / size[0], 0.62 * high / size[1])
    offset = np.array([0.5 * wide, 0.50 * high]) - scale * (low + size / 2)

    corners = picture.moved[picture.triangles]
    place = np.stack([corners @ across, corners @ up], axis=-1) * scale + offset
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    seen = front_triangles(place, -(corners @ away).mean(axis=1), high, wide)
    light = np.clip(normal @ _unit([0.9, 1.2, 0.9]), 0, 1) * 0.55 + 0.55
    colours = ColourScale(SIGNED, GAP_END_MM).at(picture.gap_mm[picture.triangles].mean(axis=1))
    colours[~np.isfinite(colours).all(axis=1)] = (0.80, 0.78, 0.74)
    shaded = np.clip(colours * light[:, None], 0, 1)
    pixels = np.full((high, wide, 3), 255, np.uint8)
    inside = seen != NO_TRIANGLE
    pixels[inside] = np.rint(255 * shaded[seen[inside]]).astype(np.uint8)
    image = Image.fromarray(pixels[::-1])
    pen = ImageDraw.Draw(image)
    _plates(pen, picture, all_points, (across, up), scale, offset, high)
    image = image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
    return _captioned(image, picture.caption)


def _view(turn: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the directions away from the viewer, to the right and upwards."""
    tilt = np.deg2rad(12.0)
    across = np.array([-np.sin(turn), 0.0, np.cos(turn)])
    away = np.array([-np.cos(turn) * np.cos(tilt), -np.sin(tilt), -np.sin(turn) * np.cos(tilt)])
    up = np.cross(across, away)
    return away, across, up if up[1] > 0 else -up


def _plates(pen, picture, points, view, scale, offset, high) -> None:  # type: ignore[no-untyped-def]
    across, up = view
    (x0, z0), (x1, z1) = points[:, [0, 2]].min(axis=0), points[:, [0, 2]].max(axis=0)
    for y, side in zip(picture.plates_mm, (-1, 1), strict=True):
        across_plate = ((x0, z0), (x1, z0), (x1, z1 + BEYOND_MM), (x0, z1 + BEYOND_MM))
        square = np.array([[x, y + side * CLEAR_MM, z] for x, z in across_plate])
        flat = np.column_stack([square @ across, square @ up]) * scale + offset
        line = [(float(px), float(high - py)) for px, py in flat]
        pen.line([*line, line[0]], fill=PLATE, width=2 * SMOOTH)


def _captioned(image: Image.Image, caption: tuple[str, str]) -> Image.Image:
    font = Path(matplotlib.get_data_path(), "fonts/ttf/DejaVuSans.ttf")
    pen = ImageDraw.Draw(image)
    pen.text((16, 12), caption[0], fill=INK, font=ImageFont.truetype(str(font), 17))
    pen.text((16, 36), caption[1], fill=INK, font=ImageFont.truetype(str(font), 15))
    scale = ColourScale(SIGNED, GAP_END_MM)
    bar = scale.at(np.linspace(-GAP_END_MM, GAP_END_MM, 200))
    strip = Image.fromarray(np.repeat(np.rint(255 * bar).astype(np.uint8)[None], 10, axis=0))
    image.paste(strip, (WIDTH - 220, HEIGHT - 44))
    small = ImageFont.truetype(str(font), 12)
    for value, x in ((-GAP_END_MM, 0), (0.0, 100), (GAP_END_MM, 200)):
        pen.text((WIDTH - 220 + x, HEIGHT - 30), f"{value:g}", fill=INK, font=small, anchor="ma")
    label = "gap, model minus image (mm)"
    pen.text((WIDTH - 120, HEIGHT - 62), label, fill=INK, font=small, anchor="ma")
    return image


def _unit(vector: list[float]) -> FloatArray:
    return np.asarray(vector) / np.linalg.norm(vector)


def main(folder: Path, out: Path) -> None:
    """Write the animation of a finished study."""
    pictures = frames(folder)
    images = [draw(one, pictures) for one in pictures]
    stacked = Image.fromarray(np.concatenate([np.asarray(image) for image in images]))
    shared = stacked.quantize(COLOURS)
    reduced = [image.quantize(palette=shared, dither=Image.Dither.NONE) for image in images]
    times = [MS] * (len(images) - 1) + [LAST_MS]
    reduced[0].save(out, save_all=True, append_images=reduced[1:], duration=times, loop=0)
    sys.stdout.write(f"{out}: {len(images)} frames, {out.stat().st_size / 1024:.0f} kB\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
