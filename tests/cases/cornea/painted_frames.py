"""Frames of a generated cornea as files, with artefacts from viewers, eyelids and exports."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from palpate.workers.organs.cornea.section_mesh import deformed_section, mesh_section
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section, generated_section
from tests.workers.organs.cornea.frames.generated_frame import generated_frame

PIXEL_MM = (0.015625, 0.0165)
SHAPE = (240, 576)
CORNEA = generated_section(points=801)
MESH = mesh_section(CORNEA, 240)
# The middle of the frame, and the row of the apex in mm.
MIDDLE_MM, APEX_MM = 4.5, 0.6

Pixels = NDArray[np.uint8]
Brush = Callable[[ImageDraw.ImageDraw], Any]


def eye(
    dent_mm: float = 0.0, shift_mm: tuple[float, float] = (0.0, 0.0), tilt_deg: float = 0.0
) -> Section:
    """Return a cornea of 7.8 mm and 0.595 mm in a frame, dented by a jet, and moved."""
    down = dent_mm * np.exp(-((MESH.nodes_mm[:, 0] / 1.6) ** 2))
    moved = deformed_section(CORNEA, MESH, np.column_stack([0 * down, -down]), 12)
    top = float(CORNEA.anterior_mm[:, 1].max())
    place = (MIDDLE_MM + shift_mm[0], shift_mm[1] - top - APEX_MM)
    return RigidMotion(place, float(np.radians(tilt_deg))).of_section(moved)


def pixels_of(section: Section, seed: int = 0) -> Pixels:
    """Return a frame of 576 x 240 grey pixels."""
    return generated_frame(section, PIXEL_MM, SHAPE, seed=seed).grey.astype(np.uint8)


REST, DENTED = pixels_of(eye()), pixels_of(eye(1.0), 1)


def painted(pixels: Pixels, brush: Brush) -> Pixels:
    """Return a frame as a colour picture with a drawing on it."""
    image = Image.fromarray(np.repeat(pixels[:, :, None], 3, axis=2))
    brush(ImageDraw.Draw(image))
    return np.asarray(image)


def resized(pixels: Pixels, across: float, down: float | None = None) -> Pixels:
    """Return a frame exported at another size."""
    size = (round(across * pixels.shape[1]), round((down or across) * pixels.shape[0]))
    return np.asarray(Image.fromarray(pixels).resize(size))


def saved(pixels: Pixels, path: Path, **more: Any) -> dict[str, Any]:
    """Write a frame to a file, and return its entry in a study file."""
    Image.fromarray(pixels).save(path, **more)
    return {"file": str(path), "pixel_mm": list(PIXEL_MM), "refraction": None}


def surface_pixels(section: Section, lift: float = 0.0) -> list[tuple[float, float]]:
    """Return points of the anterior surface in pixels, lifted by `lift` pixels."""
    x = np.linspace(0.0, SHAPE[1] * PIXEL_MM[0], 200)
    y = np.interp(x, *section.anterior_mm.T)
    return [(a / PIXEL_MM[0], -b / PIXEL_MM[1] - lift) for a, b in zip(x, y, strict=True)]
