"""Plausibility checks of two frames of a cornea: before a jet and under it."""

from collections.abc import Iterator

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.frames.checks import SMOOTH_MM, Imaged
from palpate.workers.organs.cornea.frames.registration import register_periphery
from palpate.workers.organs.cornea.section.contour_distance import distances
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.section.shape import depth_mm
from palpate.workers.organs.cornea.spec import CorneaCase
from palpate.workers.organs.study_checks import Finding

# Half width of the middle whose motion is the depth of the dent, and plausible depths.
MIDDLE_MM = 0.5
LEAST_DEPTH_MM, MOST_DEPTH_MM = 0.02, 2.5
# Plausible ratios of target to reference: thickness of the periphery, and local thickness.
SCALE = (0.85, 1.18)
LOCAL_THICKNESS = (0.75, 1.33)
OUTER_MM = 1.0
# Frames of one camera differ in size by cropping, not by more than this fraction.
SAME_WIDTH = 0.2
# Motions of the periphery from which it is reported, and beyond which it is implausible.
NAMED_MM, NAMED_DEG = 0.1, 0.5
MOST_SHIFT_MM, MOST_TILT_DEG = 1.0, 5.0


def check_pair(rest: Imaged, pressed: Imaged, case: CorneaCase) -> Iterator[Finding]:
    """Check whether two frames show one eye before and under a jet."""
    found = [*_raster(rest, pressed)] or [*_depth(rest, pressed)] or [*_same_eye(rest, pressed)]
    yield from found
    if not found:
        yield from _motion(rest, pressed, case)


def exchanged(rest: Imaged, pressed: Imaged) -> Iterator[Finding]:
    """Yield a finding if the reference is the dented frame and the target a smooth, convex one."""
    smooth = abs(pressed.shape.anterior_bump.height_mm) < SMOOTH_MM
    try:
        depth = depth_mm(rest.section, pressed.section, MIDDLE_MM)
    except InputError:
        return
    if smooth and pressed.shape.radius_mm > 0 and depth < -LEAST_DEPTH_MM:
        yield Finding(
            "implausible",
            f"The middle of the cornea moves outwards by {-depth:.2f} mm from {rest.name} to "
            f"{pressed.name}; an air jet moves it inwards. Reference and target look swapped.",
        )


def _raster(rest: Imaged, pressed: Imaged) -> Iterator[Finding]:
    """Yield findings on the sizes of the pictures and of their pixels."""
    pixels = [np.array(one.spec.pixel_mm) for one in (rest, pressed)]
    stated = ", ".join(
        f"{one.key}.pixel_mm is [{one.spec.pixel_mm[0]:g}, {one.spec.pixel_mm[1]:g}]"
        for one in (rest, pressed)
    )
    ratio = float(np.exp(np.abs(np.log(pixels[1] / pixels[0])).max()))
    if rest.picture is None or pressed.picture is None:
        return
    columns = [one.picture.shape[1] for one in (rest, pressed) if one.picture is not None]
    counts = f"{columns[0]} and {columns[1]} columns"
    if ratio > 1.01 and columns[0] == columns[1]:
        yield Finding(
            "implausible",
            f"{rest.file.name} and {pressed.file.name} both have {columns[0]} columns, but "
            f"{stated}; frames of one camera have one scale. Give both the same pixel_mm.",
        )
        return
    widths = [n * float(p[0]) for n, p in zip(columns, pixels, strict=True)]
    if abs(widths[1] / widths[0] - 1) > SAME_WIDTH:
        factor = float(pixels[0][0]) * columns[0] / columns[1]
        yield Finding(
            "implausible",
            f"{rest.file.name} and {pressed.file.name} have {counts}, which are {widths[0]:.2f} "
            f"and {widths[1]:.2f} mm wide ({stated}); frames of one camera are equally wide. If "
            f"the target was exported at another size, its pixels are {factor:.6g} mm wide.",
        )


def _depth(rest: Imaged, pressed: Imaged) -> Iterator[Finding]:
    both = f"from {rest.name} to {pressed.name}"
    try:
        depth = depth_mm(rest.section, pressed.section, MIDDLE_MM)
    except InputError as error:
        yield Finding("implausible", f"{both}: {error}")
        return
    if depth < -LEAST_DEPTH_MM:
        yield Finding(
            "implausible",
            f"The middle of the cornea moves outwards by {-depth:.2f} mm {both}; an air jet moves "
            "it inwards. Check first_pixel of both frames.",
        )
    elif depth < LEAST_DEPTH_MM:
        yield Finding(
            "implausible",
            f"The middle of the cornea moves by {1000 * abs(depth):.0f} um {both}, less than the "
            f"{1000 * LEAST_DEPTH_MM:.0f} um by which a surface may be misplaced: the deformation "
            "cannot be measured. Give a frame under the jet.",
        )
    elif depth > MOST_DEPTH_MM:
        yield Finding(
            "implausible",
            f"The middle of the cornea moves inwards by {depth:.2f} mm {both}; an air jet moves it "
            f"by less than {MOST_DEPTH_MM:g} mm. Check first_pixel and pixel_mm of both frames.",
        )


def _same_eye(rest: Imaged, pressed: Imaged) -> Iterator[Finding]:
    """Compare the thickness along both sections, which a jet hardly changes."""
    x, ratio = _thickness_ratio(rest.section, pressed.section)
    outer = (x < x[0] + OUTER_MM) | (x > x[-1] - OUTER_MM)
    scale = float(np.median(ratio[outer]))
    if not SCALE[0] <= scale <= SCALE[1]:
        yield Finding(
            "implausible",
            f"Near its edges the cornea is {scale:.2f} times as thick in {pressed.name} as in "
            f"{rest.name}; a jet does not change it there. Check that both frames have one scale "
            "and show one eye.",
        )
        return
    at = int(np.argmax(np.abs(np.log(ratio))))
    if not LOCAL_THICKNESS[0] <= ratio[at] <= LOCAL_THICKNESS[1]:
        where = pressed.pixel_at(pressed.section.anterior_mm, float(x[at]))
        yield Finding(
            "implausible",
            f"At {where} the cornea is {ratio[at]:.2f} times as thick in {pressed.name} as in "
            f"{rest.name}; under a jet it stays within {LOCAL_THICKNESS[0]:g} to "
            f"{LOCAL_THICKNESS[1]:g} times. Look there for a reflection, a lid, lashes or text, "
            f"and give another frame.{pressed.causes}",
        )


def _thickness_ratio(rest: Section, pressed: Section) -> tuple[FloatArray, FloatArray]:
    ends = [(s.anterior_mm[0, 0], s.anterior_mm[-1, 0]) for s in (rest, pressed)]
    x = np.linspace(max(e[0] for e in ends), min(e[1] for e in ends), 200)
    before, after = (
        np.interp(x, s.anterior_mm[:, 0], distances(s.anterior_mm, s.posterior_mm))
        for s in (rest, pressed)
    )
    return x, after / before


def _motion(rest: Imaged, pressed: Imaged, case: CorneaCase) -> Iterator[Finding]:
    """Yield a finding on a motion of the whole eye, which a study searches only on request."""
    try:
        found = register_periphery(rest.section, pressed.section, OUTER_MM)
    except InputError as error:
        yield Finding("implausible", str(error))
        return
    y_mm, tilt_deg = found.motion.shift_mm[1], float(np.degrees(found.motion.tilt_rad))
    sideways = abs(found.motion.tilt_rad * rest.shape.radius_mm)
    stated = {"eye_shift_y_mm", "eye_tilt_deg"} & set(case.constants)
    moved = f"The edges of the cornea move by {y_mm:+.2f} mm along y and turn by {tilt_deg:+.1f} "
    moved += f"degrees (or shift sideways by {sideways:.2f} mm, which looks the same) "
    moved += f"from {rest.name} to {pressed.name}"
    if abs(y_mm) > MOST_SHIFT_MM or abs(tilt_deg) > MOST_TILT_DEG:
        yield Finding(
            "implausible",
            f"{moved}; an eye moves by less than {MOST_SHIFT_MM:g} mm and {MOST_TILT_DEG:g} "
            "degrees. Check first_pixel, and that neither picture was turned.",
        )
    elif (abs(y_mm) > NAMED_MM or abs(tilt_deg) > NAMED_DEG) and not stated:
        yield Finding(
            "warning",
            f"{moved}: the whole eye moves, and a model with held edges mistakes that for "
            "a different stiffness. Search eye_shift_y_mm and eye_tilt_deg as well, or see "
            "`palpate diagnose`.",
        )
