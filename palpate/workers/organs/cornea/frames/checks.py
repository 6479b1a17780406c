"""Plausibility checks of one frame of a cornea."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.organs.cornea.frames.frame import Frame
from palpate.workers.organs.cornea.frames.picture import (
    box_of,
    coloured_pixels,
    likely_causes,
    read_picture,
)
from palpate.workers.organs.cornea.plausible import (
    CENTRAL_MM,
    PRESSED_CENTRAL_MM,
    RADIUS_MM,
    WIDTH_MM,
    Range,
)
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.shape import Bump, SectionShape, shape_of
from palpate.workers.organs.cornea.spec import FrameSpec
from palpate.workers.organs.study_checks import Finding

# Largest deviation of a cornea at rest from a smooth curve; 0.015 mm in a Corvis frame.
SMOOTH_MM = 0.08
# Coloured pixels this close to a surface affect its segmentation.
NEAR_SURFACE_MM = 0.15
# Factors by which a picture may have been exported, the most probable first.
FACTORS = (1.0, 2.0, 0.5, 4.0, 0.25, 3.0, 1 / 3, 10.0, 0.1)


@dataclass(frozen=True)
class Imaged:
    """A frame and the section segmented in it.

    Parameters
    ----------
    key : str
        Key of the frame in the study file.
    file : Path
    spec : FrameSpec
    section : Section
    """

    key: str
    file: Path
    spec: FrameSpec
    section: Section

    @cached_property
    def shape(self) -> SectionShape:
        """Return the measures of the section."""
        return shape_of(self.section)

    @cached_property
    def picture(self) -> FloatArray | None:
        """Return the picture; None if the file is on another machine."""
        return read_picture(self.file) if self.file.is_file() else None

    @property
    def name(self) -> str:
        """Return the frame as a subject of a sentence."""
        return f"{self.file.name} ({self.key})"

    @property
    def causes(self) -> str:
        """Return the parts of the picture that may have misled the segmentation."""
        return "" if self.picture is None else likely_causes(self.picture)

    def pixel_at(self, surface_mm: FloatArray, x_mm: float) -> str:
        """Return the column and row of a surface at x."""
        y_mm = float(np.interp(x_mm, *surface_mm.T))
        first, (width, height) = self.spec.first_pixel, self.spec.pixel_mm
        return f"column {x_mm / width - first[0]:.0f}, row {-y_mm / height - first[1]:.0f}"


def check_frame(rest: Imaged) -> Iterator[Finding]:
    """Check the frame before the jet on its own."""
    yield from _colours(rest)
    shape = rest.shape
    if shape.radius_mm < 0:
        yield _concave(rest)
        return
    yield from _sizes(rest, (RADIUS_MM, CENTRAL_MM, WIDTH_MM))
    yield from _bumps(rest)


def check_under_jet(pressed: Imaged) -> Iterator[Finding]:
    """Check the frame under the jet on its own."""
    yield from _colours(pressed)
    yield from _sizes(pressed, (None, PRESSED_CENTRAL_MM, WIDTH_MM))


def _colours(frame: Imaged) -> Iterator[Finding]:
    if frame.picture is None:
        return
    coloured = coloured_pixels(frame.picture)
    if not coloured.any():
        return
    near = coloured & _near_surfaces(frame, coloured.shape)
    shown = near if near.any() else coloured
    where, count = box_of(shown), int(shown.sum())
    what = f"{frame.name} has {count:,} coloured pixels {{}} in {where}; a frame is grey."
    advice = "Export it without lines, contours, text or false colours."
    if near.any():
        yield Finding("implausible", f"{what.format('on or near the cornea')} {advice}")
    else:
        yield Finding("warning", f"{what.format('next to the cornea')} They were read as grey.")


def _near_surfaces(frame: Imaged, shape: tuple[int, ...]) -> BoolArray:
    """Return a mask of the pixels in or near the cornea as it appears."""
    spec, section = frame.spec, frame.section
    raster = Frame(np.zeros(shape), spec.pixel_mm, spec.first_pixel)
    mask = np.zeros(shape, np.bool_)
    top, bottom = (raster.to_pixels(line) for line in (section.anterior_mm, section.posterior_mm))
    columns = np.arange(max(0, int(top[0, 0])), min(shape[1], int(top[-1, 0]) + 1))
    rows = np.arange(shape[0])[:, None]
    margin = NEAR_SURFACE_MM / spec.pixel_mm[1]
    above = np.interp(columns, *top.T) - margin
    below = np.interp(columns, *bottom.T) + margin
    mask[:, columns] = (rows >= above) & (rows <= below)
    return mask


def _concave(rest: Imaged) -> Finding:
    text = (
        f"{rest.name}: the anterior surface curves into the eye, with a radius of "
        f"{-rest.shape.radius_mm:.1f} mm; at rest it curves outwards, with a radius of {RADIUS_MM}."
    )
    if abs(rest.shape.anterior_bump.height_mm) > SMOOTH_MM:
        return Finding("implausible", f"{text} Give a frame before the jet.{rest.causes}")
    return Finding(
        "implausible",
        f"{text} The picture looks upside down: rotate it so that the front of the eye is at the "
        f"top.{rest.causes}",
    )


def _sizes(frame: Imaged, ranges: tuple[Range | None, Range, Range]) -> Iterator[Finding]:
    shape = frame.shape
    values = (shape.radius_mm, shape.central_thickness_mm, shape.width_mm)
    names = ("the radius of the anterior surface", "the central thickness", "the width shown")
    wrong = [
        f"{name} is {value:.3g} mm (usual for a cornea: {usual})"
        for name, value, usual in zip(names, values, ranges, strict=True)
        if usual is not None and value not in usual
    ]
    if wrong:
        width, height = frame.spec.pixel_mm
        yield Finding(
            "implausible",
            f"{frame.name}, in pixels of {width:g} x {height:g} mm: {', '.join(wrong)}."
            f"{_likely_scale(frame, ranges)}{frame.causes}",
        )


def _likely_scale(frame: Imaged, ranges: tuple[Range | None, Range, Range]) -> str:
    """Return a correction that would make the measures fit: a scale, or refraction."""
    shape, (width, height) = frame.shape, frame.spec.pixel_mm
    radius, thick, wide = ranges
    # Without the radius, a picture stretched along one axis looks like another cornea.
    stretched = radius is not None and shape.radius_mm not in radius
    pairs = product(FACTORS, FACTORS) if stretched else zip(FACTORS, FACTORS, strict=True)
    for across, down in sorted(pairs, key=_unlikely):
        fits = (
            (radius is None or shape.radius_mm * across**2 / down in radius)
            and shape.central_thickness_mm * down in thick
            and shape.width_mm * across in wide
        )
        if fits and (across, down) != (1, 1):
            size = f"{1 / across:.3g}" if across == down else f"{1 / across:.3g} x {1 / down:.3g}"
            return (
                f" The picture seems to have been exported at {size} times its size: set pixel_mm "
                f"to [{across * width:.6g}, {down * height:.6g}], or give the original picture."
            )
    if frame.spec.refraction is None and shape.central_thickness_mm < thick.least:
        return (
            " With refraction: null the posterior surface is left where it appears; remove that "
            "line unless the device has corrected it."
        )
    if frame.spec.refraction is not None and shape.central_thickness_mm > thick.most:
        return (
            " If the device has already corrected the posterior surface, set refraction: null; "
            "otherwise check pixel_mm and the picture."
        )
    return " Check pixel_mm, and whether the picture shows the whole frame."


def _unlikely(factors: tuple[float, float]) -> tuple[bool, int]:
    across, down = factors
    return across != down, FACTORS.index(across) + FACTORS.index(down)


def _bumps(rest: Imaged) -> Iterator[Finding]:
    shape, section = rest.shape, rest.section
    surfaces: tuple[tuple[str, Bump, FloatArray], ...] = (
        ("anterior", shape.anterior_bump, section.anterior_mm),
        ("posterior", shape.posterior_bump, section.posterior_mm),
    )
    for name, (height_mm, x_mm), line in surfaces:
        if abs(height_mm) > SMOOTH_MM:
            side = "outwards" if height_mm > 0 else "inwards"
            yield Finding(
                "implausible",
                f"{rest.name}: the {name} surface deviates by {abs(height_mm):.2f} mm {side} from "
                f"a smooth curve at {rest.pixel_at(line, x_mm)}; at rest a cornea deviates by less "
                f"than {SMOOTH_MM:g} mm. Look there for a reflection, a lid, lashes or text, and "
                f"give another frame.{rest.causes}",
            )
