"""Findings about a fitted eye and their limits: numbers, sentences and charts for a report.

See `workers.organs.organ_plugins.Findings`. Numbers have units in their names; bounds are
relative Cramer-Rao bounds, one standard deviation. Frames are shown with the segmented, expected
and fitted surfaces drawn on them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, FreeParameter
from palpate.workers.organs.cornea.constant_doubts import (
    against,
    derived,
    notes,
    profile_of,
    refitted_constants,
)
from palpate.workers.organs.cornea.cornea_keys import (
    CorneaCase,
    CorneaScore,
    CorneaTarget,
    FindingsSpec,
    FrameSpec,
)
from palpate.workers.organs.cornea.cornea_problem import (
    Candidate,
    MeshForModels,
    candidate_of,
    constants_of,
    scale_of,
)
from palpate.workers.organs.cornea.corneal_model import MPA_PER_MMHG
from palpate.workers.organs.cornea.identifiability import (
    MODEL_ERROR,
    ContourNoise,
    FittedContour,
    Information,
    attained_stretches,
    contour_of,
    information_of,
    information_of_pressures,
    law_names,
    pixel_rounding,
    plain_name,
    shear_modulus_bound,
    shear_modulus_slope,
    stress_curve,
    stress_slope,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import (
    CandidateChange,
    sensitivity,
    thickness_change,
)
from palpate.workers.organs.cornea.section_outline import Section, arclength_mm, points_at
from palpate.workers.organs.cornea.tonometer_frames import Frame, read_frame, register_periphery

Colour = tuple[int, int, int]
# The brightest pixels are clipped, so that tissue stays visible next to a reflex.
WHITE_PERCENTILE = 99.8


def overlay(
    frame: Frame, contours: Sequence[tuple[FloatArray, Colour]], width_px: float = 1.0
) -> NDArray[np.uint8]:
    """Return a frame as a colour image with contours drawn on it.

    Parameters
    ----------
    frame : Frame
    contours : sequence of (ndarray, colour)
        Polylines (n, 2) in mm in the coordinates of the frame, with red, green and blue from
        0 to 255; later ones are on top. Parts outside the image are not drawn.
    width_px : float
        Width of the lines; > 0.

    Returns
    -------
    ndarray of uint8, shape (rows, columns, 3)
    """
    black, white = np.percentile(frame.grey, [1.0, WHITE_PERCENTILE])
    grey = np.clip((frame.grey - black) / max(white - black, 1e-12), 0.0, 1.0)
    picture = np.repeat(255 * grey[:, :, None], 3, axis=2)
    for contour, colour in contours:
        cover = _coverage(frame.to_pixels(contour), grey.shape, width_px)[:, :, None]
        picture = (1 - cover) * picture + cover * np.array(colour, dtype=np.float64)
    return np.rint(picture).astype(np.uint8)


def _coverage(line: FloatArray, shape: tuple[int, ...], width: float) -> FloatArray:
    """Return the fraction of each pixel covered by a line, from its nearest sample."""
    length = float(arclength_mm(line)[-1])
    dense = points_at(line, np.linspace(0.0, length, int(np.ceil(4 * length)) + 1))
    cover = np.zeros(shape)
    reach = int(np.ceil(width / 2 + 0.5))
    base = np.rint(dense).astype(np.int64)
    for dx in range(-reach, reach + 1):
        for dy in range(-reach, reach + 1):
            column, row = base[:, 0] + dx, base[:, 1] + dy
            inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
            far = np.hypot(column - dense[:, 0], row - dense[:, 1])[inside]
            part = np.clip(0.5 + width / 2 - far, 0.0, 1.0)
            np.maximum.at(cover, (row[inside], column[inside]), part)
    return cover


FOUND_COLOUR: Colour = (230, 60, 50)
CARRIED_COLOUR: Colour = (90, 190, 240)
EXPLAINED_COLOUR: Colour = (240, 180, 30)
LINE_PX = 2.0
# Width of the periphery on each side, which moves only with the whole eye.
OUTER_MM = 1.0

DescribedImage = tuple[str, NDArray[np.uint8]]


def overlays(
    case: CorneaCase,
    target: CorneaTarget,
    undeformed: Section | None,
    deformed: Section | None,
    explained: Section | None,
) -> list[DescribedImage]:
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
        drawn += _drawn(case.reference.frame, sentence, [(undeformed, FOUND_COLOUR)])
    if target.frame is not None and deformed is not None:
        shown = [(deformed, FOUND_COLOUR)]
        sentence = "Under the puff: as segmented (red)"
        if undeformed is not None:
            moved, words = _carried(undeformed, deformed)
            shown, sentence = [(moved, CARRIED_COLOUR), *shown], sentence + words
        if explained is not None:
            shown, sentence = (
                [*shown, (explained, EXPLAINED_COLOUR)],
                sentence + ", best fit (yellow)",
            )
        drawn += _drawn(target.frame, f"{sentence}.", shown)
    return drawn


def _drawn(
    spec: FrameSpec, sentence: str, shown: Sequence[tuple[Section, Colour]]
) -> list[DescribedImage]:
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


# Okabe and Ito's colours, as in the report.
CHART_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")
SOFT_COLOUR = "#5d6775"
SMALL_PT = 9.0
# Smaller parts of a combination are not named.
LEAST_PART = 0.15

DescribedFigure = tuple[Figure, str]


def finding_charts(
    numbers: Mapping[str, Any], derived: Sequence[Mapping[str, Any]] = ()
) -> Iterator[DescribedFigure]:
    """Yield figures of the findings, each with its caption.

    ``derived`` are values with their ``interval``, if it is known.
    """
    yield _stress_chart(numbers, derived)
    yield _singular_value_chart(numbers)
    yield _bound_chart(numbers)
    if "profiles" in numbers:
        yield _profile_chart(numbers["profiles"])


def image_figure(image: np.ndarray[Any, Any]) -> Figure:
    """Return a colour image as a figure of the page's width."""
    shown = Figure(figsize=(10.4, 10.4 * image.shape[0] / image.shape[1]), layout="constrained")
    axes = shown.subplots()
    axes.imshow(image)
    axes.axis("off")
    return shown


def _chart_axes(x_label: str, y_label: str, height_in: float = 3.4) -> tuple[Figure, Axes]:
    shown = Figure(figsize=(7.8, height_in), layout="constrained", facecolor="white")
    axes = shown.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=SOFT_COLOUR, labelsize=SMALL_PT)
    axes.grid(True, axis="y", color="#d8dde4", linewidth=0.7)
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.set_axisbelow(True)
    return shown, axes


def _stress_chart(
    numbers: Mapping[str, Any], derived: Sequence[Mapping[str, Any]]
) -> DescribedFigure:
    curve = numbers["stress_curve"]
    shown, axes = _chart_axes("stretch", "stress, MPa")
    axes.plot(curve["stretch"], curve["stress_mpa"], color=CHART_COLOURS[0], linewidth=1.8)
    known = [
        stress for stress in derived if "stretch" in stress and stress.get("interval") is not None
    ]
    for stress in known:
        low, high = (end / 1000 for end in stress["interval"])
        axes.errorbar(
            stress["stretch"],
            stress["value"] / 1000,
            [[stress["value"] / 1000 - low], [high - stress["value"] / 1000]],
            color=CHART_COLOURS[0],
            capsize=4,
        )
    axes.axvline(curve["attained"], color=SOFT_COLOUR, linestyle=":", linewidth=1.2)
    bars = " with 90 % intervals" if known else ""
    return shown, (
        f"Stress against stretch for the fitted law, for a strip under tension{bars}. Dotted: the "
        "largest stretch in this eye; the image does not determine the curve beyond it."
    )


def _singular_value_chart(numbers: Mapping[str, Any]) -> DescribedFigure:
    labels = [
        "\n".join(
            f"{plain_name(name)} {part:+.2f}"
            for name, part in zip(numbers["constants"], direction, strict=True)
            if abs(part) > LEAST_PART
        )
        for direction in numbers["directions"]
    ]
    shown, axes = _chart_axes("", "shift, µm", 4.0)
    _draw_marks(axes, {"": numbers["singular_values_um"]}, labels)
    return shown, (
        "Shift of the contour, root mean square, when a combination of the logarithms of the "
        "constants grows by one. Combinations whose shift is below the resolution of the image "
        "may take any value."
    )


def _bound_chart(numbers: Mapping[str, Any]) -> DescribedFigure:
    noises, bounds = numbers["noises"], numbers["bounds"]
    count = len(numbers["jet_fractions"])
    series = {f"one image, {noises[key]}": bounds[key] for key in ("model", "pixels")}
    if numbers["bounds_of_several_pressures"] is not None:
        several = f"{count} pressures of the jet, {noises['pixels']}"
        series[several] = numbers["bounds_of_several_pressures"]
    shown, axes = _chart_axes("", "relative error, %")
    percents = {title: [100 * v for v in errors.values()] for title, errors in series.items()}
    _draw_marks(axes, percents, [plain_name(name) for name in numbers["constants"]])
    axes.legend(frameon=False, fontsize=SMALL_PT, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return shown, ("Uncertainty of each constant: Cramer-Rao bounds, one standard deviation.")


def _profile_chart(profiles: Sequence[Mapping[str, Any]]) -> DescribedFigure:
    shown, axes = _chart_axes("held value over fitted value", "misfit, µm")
    for profile, colour in zip(profiles, CHART_COLOURS, strict=False):
        y = [np.nan if value is None else value for value in profile["misfit_um"]]
        axes.plot(profile["factor"], y, "o-", color=colour, label=plain_name(profile["name"]))
    axes.legend(frameon=False, fontsize=SMALL_PT)
    return shown, (
        "Smallest misfit of the contour with one constant held at a multiple of its fitted value "
        "and the others refitted. Values with a misfit below the image error are compatible with "
        "the image."
    )


def _draw_marks(axes: Axes, series: Mapping[str, Sequence[float]], names: Sequence[str]) -> None:
    for (title, values), colour in zip(series.items(), CHART_COLOURS, strict=False):
        axes.plot(range(len(values)), values, "o", color=colour, label=title)
    axes.set_yscale("log")
    axes.set_xticks(range(len(names)), names, fontsize=SMALL_PT)
    axes.set_xlim(-0.5, len(names) - 0.5)


# The curve is drawn from rest to this fraction beyond the largest stretch.
CURVE_BEYOND = 1.25
CURVE_POINTS = 41
# Factors at which a constant is held for its profile.
PROFILE_LOGARITHMS = np.log([0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4])
# Prior standard deviation of the constants' logarithms: a factor of e either way.
PRIOR_SD = 1.0
# Quantities not measured together with the images, and their possible errors.
ASSUMED = {
    "iop": ("iop_mpa", MPA_PER_MMHG, "1 mmHg more intraocular pressure"),
    "jet_pressure": ("jet_pressure_mpa", None, "1 % more jet pressure"),
    "pachymetry": ("thickness_mm", 0.01, "10 µm more thickness"),
}


def findings(
    model: MeshForModels,
    case: CorneaCase,
    constants: Mapping[str, float],
    middle_mm: float,
    score: CorneaScore,
    body: Section | None = None,
    free: Sequence[FreeParameter] = (),
) -> dict[str, Any]:
    """Return the findings about the constants from the deformed section of a fitted eye.

    Parameters
    ----------
    model : MeshForModels
    case : CorneaCase
    constants : mapping of str to float
        All constants of the best candidate, in internal names and units.
    middle_mm : float
        See `workers.organs.cornea.cornea_problem.middle_of`.
    score : CorneaScore
        Its window is the part shown by the image, its pixels are the resolution.
    body : Section, optional
        The undeformed section, for the mesh error.
    free : sequence of FreeParameter
        The searched constants.

    Returns
    -------
    dict
        ``notes`` and ``numbers``, see `workers.organs.organ_plugins.Findings`; ``derived`` and
        ``against``, see `workers.organs.cornea.constant_doubts`.
        Empty if the best candidate cannot be solved again.
    """
    candidate = candidate_of(model, case, constants, middle_mm)
    names = law_names(candidate.constants)
    changes: list[CandidateChange | str] = [*names]
    if candidate.load.iop_mpa > 0 and candidate.load.jet_pressure_mpa > 0:
        changes += ["iop_mpa", "jet_pressure_mpa", thickness_change(candidate)]
    result = sensitivity(candidate, changes)
    if not result.solution.converged:
        return {}
    k = len(names)
    law = replace(result, derivatives=result.derivatives[:k])
    contour = contour_of(candidate, law, names, score.window_mm)
    eye = FittedEye(candidate, contour, information_of(candidate, contour))
    noise = pixel_rounding(score.pixel_um)
    numbers: dict[str, Any] = {
        **_identified(eye, noise),
        "attained_stretches": list(attained_stretches(candidate, result.solution.displacement_mm)),
        **_pressures(eye, case.findings, noise, score),
    }
    numbers["stress_curve"] = _curve(eye, numbers["attained_stretches"][1], noise)
    if len(changes) > k:
        best = numbers["stress_curve"]["best_known_stretch"]
        numbers["assumptions"] = _assumptions(eye, result.derivatives[k:], best)
    if case.findings.profiles:
        numbers["profiles"] = _profiles(candidate, result.solution.displacement_mm, score)
    numbers["not_measured"] = list(case.findings.not_measured)
    moved = (
        None if body is None else refitted_constants(model, case, body, constants, middle_mm, free)
    )
    refitted = None if moved is None else constants_of(case, moved)
    return {
        "notes": notes(numbers, case),
        "numbers": numbers,
        "derived": derived(numbers, candidate.constants, refitted),
        "against": against(numbers),
    }


def figures(
    spec: Any, bodies: Sequence[Section | None], findings: Mapping[str, Any]
) -> Iterator[tuple[Figure, str]]:
    """Yield frames with their contours, then charts of the findings, with captions.

    Parameters
    ----------
    spec : StudySpec
    bodies : sequence of Section or None
        Undeformed section, deformed section, and the best candidate's.
    findings : mapping
        The result of `findings`; may be empty. Each of ``derived`` may have an ``interval``.
    """
    for sentence, image in overlays(spec.case, spec.target, *bodies):
        yield image_figure(image), sentence
    if findings:
        yield from finding_charts(findings["numbers"], findings.get("derived", ()))


@dataclass(frozen=True, eq=False)
class FittedEye:
    """A candidate with its contour, and the information about the constants."""

    candidate: Candidate
    contour: FittedContour
    information: Information


def _identified(eye: FittedEye, noise: ContourNoise) -> dict[str, Any]:
    """Return constants with their bounds, G0, and the combinations from strong to weak."""
    constants, information = eye.candidate.constants, eye.information
    noises = {"pixels": noise, "model": MODEL_ERROR}
    return {
        "constants": dict(zip(information.names, information.values.tolist(), strict=True)),
        "bounds": {
            key: dict(zip(information.names, information.bounds(error).tolist(), strict=True))
            for key, error in noises.items()
        },
        "noises": {key: error.name for key, error in noises.items()},
        "shear_modulus_mpa": constants.shear_modulus_mpa,
        "shear_modulus_bounds": {
            key: shear_modulus_bound(constants, information, error) for key, error in noises.items()
        },
        "singular_values_um": information.singular_values_um.tolist(),
        "directions": information.directions.tolist(),
    }


def _pressures(
    eye: FittedEye, asked: FindingsSpec, noise: ContourNoise, score: CorneaScore
) -> dict[str, Any]:
    """Return the information of several frames of one puff, or of as many at one pressure."""
    fractions = asked.jet_fractions
    several = information_of_pressures(eye.candidate, fractions, score.window_mm)
    repeated = eye.information.bounds(noise) / np.sqrt(len(fractions))
    names = eye.information.names
    return {
        "jet_fractions": list(fractions),
        "bounds_of_several_pressures": None
        if several is None
        else dict(zip(names, several.bounds(noise).tolist(), strict=True)),
        "bounds_of_one_pressure_repeated": dict(zip(names, repeated.tolist(), strict=True)),
    }


def _curve(eye: FittedEye, largest: float, noise: ContourNoise) -> dict[str, Any]:
    stretch = np.linspace(1.0, 1.0 + CURVE_BEYOND * (largest - 1.0), CURVE_POINTS)
    curve = stress_curve(eye.candidate.constants, eye.information, noise, stretch)
    known = 1 + int(np.argmin(curve.sd_mpa[1:] / curve.stress_mpa[1:]))
    return {
        "best_known_stretch": float(stretch[known]),
        "best_known_stress_mpa": float(curve.stress_mpa[known]),
        "best_known_bound": float(curve.sd_mpa[known] / curve.stress_mpa[known]),
        "stretch": stretch.tolist(),
        "stress_mpa": curve.stress_mpa.tolist(),
        "attained": largest,
    }


def _assumptions(eye: FittedEye, others: FloatArray, stretch: float) -> dict[str, Any]:
    """Return the relative changes of stiffness if the assumptions were wrong.

    They refer to G0 and to the stress at the best-determined stretch.

    The constants compensate as far as `MODEL_ERROR` and `PRIOR_SD` allow.
    """
    candidate, contour = eye.candidate, eye.contour
    weight = contour.length_mm / (MODEL_ERROR.correlation_mm * MODEL_ERROR.sd_um**2)
    J = contour.shift_um
    fisher = eye.information.fisher(MODEL_ERROR)
    inner = np.linalg.inv(fisher + np.eye(len(fisher)) / PRIOR_SD**2)
    mesh = candidate.prepared.mesh
    nodes = np.concatenate([mesh.anterior, mesh.posterior])
    changed = {}
    for (key, (name, by, words)), derivative in zip(ASSUMED.items(), others, strict=True):
        size = 0.01 * scale_of(candidate, name) if by is None else by
        shift = 1e3 * size * np.einsum("ni,ni->n", derivative[nodes], contour.normal)
        step = -inner @ J.T @ (weight * shift)
        changed[key] = {
            "by": words,
            "shear_modulus_part": float(shear_modulus_slope(candidate.constants) @ step),
            "stress_part": float(stress_slope(candidate.constants, stretch) @ step),
        }
    return changed


def _profiles(
    candidate: Candidate, displacement_mm: FloatArray, score: CorneaScore
) -> Sequence[dict[str, Any]]:
    profiles = []
    for name in law_names(candidate.constants):
        profile = profile_of(candidate, displacement_mm, name, PROFILE_LOGARITHMS, score.window_mm)
        misfit = [None if np.isnan(m) else float(m) for m in profile.misfit_um]
        profiles.append({"name": name, "factor": profile.factor.tolist(), "misfit_um": misfit})
    return profiles
