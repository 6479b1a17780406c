"""Findings about a fitted eye and their limits: numbers, sentences and charts for a report.

See `workers.organs.registry.Findings`. Numbers have units in their names; bounds are
relative Cramer-Rao bounds, one standard deviation.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from palpate.storage.records.tasks import FreeParameter
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.comparison.identifiability import (
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
    shear_modulus_bound,
    shear_modulus_slope,
    stress_curve,
    stress_slope,
)
from palpate.workers.organs.cornea.findings.doubts import against, derived
from palpate.workers.organs.cornea.findings.figures import figures as drawn
from palpate.workers.organs.cornea.findings.figures import image_figure
from palpate.workers.organs.cornea.findings.mesh_shift import refitted_constants
from palpate.workers.organs.cornea.findings.notes import notes
from palpate.workers.organs.cornea.findings.profile import profile_of
from palpate.workers.organs.cornea.frames.pictures import overlays
from palpate.workers.organs.cornea.material.load import MPA_PER_MMHG
from palpate.workers.organs.cornea.problem import candidate_of, constants_of
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.solver.candidate import Candidate, scale_of
from palpate.workers.organs.cornea.solver.model_cache import MeshForModels
from palpate.workers.organs.cornea.solver.sensitivity import Change, sensitivity
from palpate.workers.organs.cornea.solver.thickness import thickness_change
from palpate.workers.organs.cornea.spec import CorneaCase, CorneaScore, FindingsSpec

# The curve is drawn from rest to this fraction beyond the largest stretch.
BEYOND = 1.25
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
        See `workers.organs.cornea.problem.middle_of`.
    score : CorneaScore
        Its window is the part shown by the image, its pixels are the resolution.
    body : Section, optional
        The undeformed section, for the mesh error.
    free : sequence of FreeParameter
        The searched constants.

    Returns
    -------
    dict
        ``notes`` and ``numbers``, see `workers.organs.registry.Findings`; ``derived`` and
        ``against``, see `workers.organs.cornea.findings.doubts`.
        Empty if the best candidate cannot be solved again.
    """
    candidate = candidate_of(model, case, constants, middle_mm)
    names = law_names(candidate.constants)
    changes: list[Change | str] = [*names]
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
        numbers["profiles"] = _profiles(eye, score)
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
        yield from drawn(findings["numbers"], findings.get("derived", ()))


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
            key: dict(zip(information.names, information.bounds(one).tolist(), strict=True))
            for key, one in noises.items()
        },
        "noises": {key: one.name for key, one in noises.items()},
        "shear_modulus_mpa": constants.shear_modulus_mpa,
        "shear_modulus_bounds": {
            key: shear_modulus_bound(constants, information, one) for key, one in noises.items()
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
    stretch = np.linspace(1.0, 1.0 + BEYOND * (largest - 1.0), CURVE_POINTS)
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
    inner = np.linalg.inv(J.T @ (weight[:, None] * J) + np.eye(J.shape[1]) / PRIOR_SD**2)
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


def _profiles(eye: FittedEye, score: CorneaScore) -> Sequence[dict[str, Any]]:
    found = []
    for name in eye.information.names:
        profile = profile_of(eye.candidate, eye.contour, name, PROFILE_LOGARITHMS, score.window_mm)
        misfit = [None if np.isnan(m) else float(m) for m in profile.misfit_um]
        found.append({"name": name, "factor": profile.factor.tolist(), "misfit_um": misfit})
    return found
