"""Plausibility checks of a cornea's section and frames, before the first task of a study.

Each frame is checked on its own, then both as a pair: before a jet and under it. A frame that
passes wrongly would be searched to the end and explained by wrong constants.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.organs.cornea.cornea_keys import (
    CorneaCase,
    CorneaScore,
    CorneaTarget,
    FrameSpec,
)
from palpate.workers.organs.cornea.corneal_model import (
    CENTRAL_MM,
    IOP_MMHG,
    JET_KPA,
    PRESSED_CENTRAL_MM,
    RADIUS_MM,
    WIDTH_MM,
    Range,
)
from palpate.workers.organs.cornea.section_measures import (
    Bump,
    SectionShape,
    depth_mm,
    distances,
    shape_of,
)
from palpate.workers.organs.cornea.section_outline import Section
from palpate.workers.organs.cornea.tonometer_frames import (
    Frame,
    box_of,
    coloured_pixels,
    likely_causes,
    read_picture,
    register_periphery,
)
from palpate.workers.organs.plausibility_rule import Finding

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


# Half width of the middle whose motion is the depth of the dent, and plausible depths.
MIDDLE_MM = 0.5
LEAST_DEPTH_MM, MOST_DEPTH_MM = 0.02, 2.5
# Plausible ratios of target to reference: thickness of the periphery, and local thickness.
THICKNESS_SCALE = (0.85, 1.18)
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
    pixels = [np.array(frame.spec.pixel_mm) for frame in (rest, pressed)]
    stated = ", ".join(
        f"{frame.key}.pixel_mm is [{frame.spec.pixel_mm[0]:g}, {frame.spec.pixel_mm[1]:g}]"
        for frame in (rest, pressed)
    )
    ratio = float(np.exp(np.abs(np.log(pixels[1] / pixels[0])).max()))
    if rest.picture is None or pressed.picture is None:
        return
    columns = [frame.picture.shape[1] for frame in (rest, pressed) if frame.picture is not None]
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
    if not THICKNESS_SCALE[0] <= scale <= THICKNESS_SCALE[1]:
        yield Finding(
            "implausible",
            f"Near its edges the cornea is {scale:.2f} times as thick in {pressed.name} as in "
            f"{rest.name}; a jet does not change it there. Check that both frames have one scale "
            "and show one eye.",
        )
        return
    peak = int(np.argmax(np.abs(np.log(ratio))))
    if not LOCAL_THICKNESS[0] <= ratio[peak] <= LOCAL_THICKNESS[1]:
        where = pressed.pixel_at(pressed.section.anterior_mm, float(x[peak]))
        yield Finding(
            "implausible",
            f"At {where} the cornea is {ratio[peak]:.2f} times as thick in {pressed.name} as in "
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
        registration = register_periphery(rest.section, pressed.section, OUTER_MM)
    except InputError as error:
        yield Finding("implausible", str(error))
        return
    y_mm, tilt_deg = (
        registration.motion.shift_mm[1],
        float(np.degrees(registration.motion.tilt_rad)),
    )
    sideways = abs(registration.motion.tilt_rad * rest.shape.radius_mm)
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


class CorneaChecks:
    """See `workers.organs.plausibility_rule.StudyChecks`."""

    def of_case(self, case: CorneaCase) -> Iterator[Finding]:
        """Check the generated section and the pressures."""
        section, jet = case.reference.section, case.load.jet
        if section is not None:
            where = "case.reference.section"
            yield from _stated(f"{where}.radius_mm", section.radius_mm, RADIUS_MM)
            yield from _stated(f"{where}.central_mm", section.central_mm, CENTRAL_MM)
            yield from _stated(f"{where}.chord_mm", section.chord_mm, WIDTH_MM)
        if case.load.iop_mmhg > 0:
            yield from _stated("case.load.iop_mmhg", case.load.iop_mmhg, IOP_MMHG)
        if jet.pressure_mpa > 0:
            key = "pressure_kpa" if jet.pressure_kpa is not None else "pressure_mmhg"
            unit = JET_KPA if jet.pressure_kpa is not None else JET_KPA.in_mmhg()
            yield from _stated(f"case.load.jet.{key}", getattr(jet, key), unit)

    def before_bodies(
        self, case: CorneaCase, target: CorneaTarget, score: CorneaScore
    ) -> Iterator[Finding]:
        """Check nothing: the model of the file has already rejected contradictions."""
        yield from ()

    def of_bodies(
        self,
        case: CorneaCase,
        target: CorneaTarget | None,
        score: CorneaScore | None,
        reference: Section | None,
        deformed: Section | None,
    ) -> Iterator[Finding]:
        """Check each frame separately, then both as a pair."""
        rest = _imaged("case.reference.frame", case.reference.frame, reference)
        pressed = None
        if target is not None:
            pressed = _imaged("target.frame", target.frame, deformed)
        pair = None if rest is None or pressed is None else (rest, pressed)
        findings = [] if pair is None else list(exchanged(*pair))
        if findings:
            yield from findings
            return
        findings += [] if rest is None else check_frame(rest)
        findings += [] if pressed is None else check_under_jet(pressed)
        yield from findings
        if pair is not None and not _refused(findings):
            yield from check_pair(*pair, case)


CHECKS = CorneaChecks()


def _imaged(key: str, spec: FrameSpec | None, section: Section | None) -> Imaged | None:
    if spec is None or section is None:
        return None
    return Imaged(key, Path(spec.file), spec, section)


def _refused(findings: list[Finding]) -> bool:
    return any(finding.severity != "warning" for finding in findings)


def _stated(key: str, value: float, usual: Range) -> Iterator[Finding]:
    if value not in usual:
        yield Finding(
            "implausible",
            f"{key} is {value:g} {usual.unit}; {usual.what} is {usual}. Give it in {usual.unit}.",
        )
