"""Frames with the segmented, expected and fitted surfaces drawn on them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.frames.overlay import Colour, overlay
from palpate.workers.organs.cornea.frames.reading import read_frame
from palpate.workers.organs.cornea.frames.registration import register_periphery
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.spec import CorneaCase, CorneaTarget, FrameSpec

FOUND: Colour = (230, 60, 50)
CARRIED: Colour = (90, 190, 240)
EXPLAINED: Colour = (240, 180, 30)
LINE_PX = 2.0
# Width of the periphery on each side, which moves only with the whole eye.
OUTER_MM = 1.0

Described = tuple[str, NDArray[np.uint8]]


def overlays(
    case: CorneaCase,
    target: CorneaTarget,
    undeformed: Section | None,
    deformed: Section | None,
    explained: Section | None,
) -> list[Described]:
    """Return each available frame with its contours, and a sentence for it.

    Parameters
    ----------
    case, target : CorneaCase, CorneaTarget
        Provide the locations of the frames.
    undeformed, deformed, explained : Section or None
        As segmented before and under the jet, and as fitted by the best candidate.
    """
    drawn = []
    if case.reference.frame is not None and undeformed is not None:
        sentence = "Before the puff, with both surfaces as segmented"
        sentence += _refracted(case.reference.frame)
        drawn += _drawn(case.reference.frame, sentence, [(undeformed, FOUND)])
    if target.frame is not None and deformed is not None:
        shown = [(deformed, FOUND)]
        sentence = "Under the puff: as segmented (red)"
        if undeformed is not None:
            moved, words = _carried(undeformed, deformed)
            shown, sentence = [(moved, CARRIED), *shown], sentence + words
        if explained is not None:
            shown, sentence = [*shown, (explained, EXPLAINED)], sentence + ", best fit (yellow)"
        drawn += _drawn(target.frame, f"{sentence}.", shown)
    return drawn


def _drawn(
    spec: FrameSpec, sentence: str, shown: Sequence[tuple[Section, Colour]]
) -> list[Described]:
    try:
        frame = read_frame(Path(spec.file), spec.pixel_mm, spec.first_pixel)
    except InputError:
        return []
    lines = [
        (surface, colour)
        for section, colour in shown
        for surface in (section.anterior_mm, section.posterior_mm)
    ]
    return [(sentence, overlay(frame, lines, LINE_PX))]


def _refracted(spec: FrameSpec) -> str:
    return "." if spec.refraction is None else "; the inner one is corrected for refraction."


def _carried(undeformed: Section, deformed: Section) -> tuple[Section, str]:
    """Return the undeformed section moved with the eye, as determined from its periphery."""
    try:
        found = register_periphery(undeformed, deformed, OUTER_MM)
    except InputError:
        return undeformed, ", before the puff (blue)"
    y, tilt = found.motion.shift_mm[1], float(np.degrees(found.motion.tilt_rad))
    words = f", before the puff and moved with the eye (blue): {y:+.3f} mm along y, {tilt:+.2f}°"
    return found.motion.of_section(undeformed), words
