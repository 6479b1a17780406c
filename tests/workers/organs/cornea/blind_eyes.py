"""Diagnosis of twenty eyes from `quad_cornea` with one hidden effect each, and of controls.

    python tests/workers/organs/cornea/blind_eyes.py RESULTS.jsonl --draw 1

Eyes already in the file are not computed again; every draw is a different set of eyes. Every
effect differs in form from the catalogue: jets with soft edges, a gradient that is a tanh, a
limbus that is softer outside, a posterior surface that is stretched. Both images have
segmentation errors made of waves instead of a Gaussian kernel.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from palpate.workers.common_keys import validated
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.effect_sensitivities import joined_sensitivity, scan_sensitivity
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.organs.cornea.cornea_keys import CorneaCase
from palpate.workers.organs.cornea.cornea_study_source import (
    SEGMENTED,
    WINDOW,
    CorneaStudy,
    CorneaStudySource,
)
from palpate.workers.organs.cornea.corneal_model import MPA_PER_MMHG
from palpate.workers.organs.cornea.section_outline import Section, generated_section
from palpate.workers.thesis.thesis_eyes import TABLE_5_2
from tests.workers.diagnosis.in_one_process import diagnose_here
from tests.workers.organs.cornea.solver.quad_cornea import Eye, deformed

NAMES = (
    *["jet_off_centre"] * 4,
    *["whole_eye_motion"] * 4,
    *["posterior_distortion"] * 4,
    *["stiffness_gradient"] * 4,
    *["limbus_compliance"] * 2,
    *["segmentation_bias"] * 2,
    *["control"] * 5,
)
# Segmentation error, as stated to the diagnosis.
SD_MM, LENGTH_MM = SEGMENTED.sd_mm, SEGMENTED.correlation_mm
# Eyes of the table without snap-through under the jet.
STIFF = [eye for eye in TABLE_5_2 if eye.constants.shear_modulus_mpa > 1.6]
BOUNDS = {"mu1": (1e-6, 0.04), "alpha1": (0.1, 100.0), "mu2": (1e-6, 0.04), "alpha2": (0.1, 100.0)}


def hidden(name, rng):
    """Return the hidden deviations of an eye: arguments of `Eye`, and distortions of the image."""
    sign = rng.choice([-1.0, 1.0])
    if name == "jet_off_centre":
        return {"jet_centre": sign * rng.uniform(0.1, 0.35), "jet_edge": 0.05}
    if name == "whole_eye_motion":
        shift = (rng.normal(0, 0.03), -rng.uniform(0.08, 0.3))
        return {"shift": shift, "tilt": sign * np.radians(rng.uniform(0.3, 1.5))}
    if name == "stiffness_gradient":
        size = rng.uniform(0.3, 0.8)
        return {"stiffer": lambda x, y: np.exp(0.5 * sign * size * np.tanh(x / 2.5))}
    if name == "limbus_compliance":
        return {"limbus_softness": rng.uniform(0.5, 1.2)}
    return {}


def drawn(surface, rng):
    """Return a surface with segmentation errors along its normal: waves of many lengths."""
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(surface, axis=0), axis=1))])
    tangent = np.gradient(surface, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    wave = np.abs(rng.normal(0, 1 / LENGTH_MM, 40))
    phase = rng.uniform(0, 2 * np.pi, 40)
    error = SD_MM * np.sqrt(2 / 40) * np.cos(arc[:, None] * wave + phase).sum(axis=1)
    return surface + error[:, None] * normal


def source_of(draw, number):
    """Make an eye and return the source of its diagnosis."""
    rng = np.random.default_rng([1914, draw, number])
    name, eye = NAMES[number], STIFF[rng.integers(len(STIFF))]
    thickness = eye.pachymetry_um / 1000
    section = generated_section(7.8, 11.7, thickness, thickness + 0.105)
    mu1, alpha1, mu2, alpha2 = eye.constants
    top, bottom = deformed(
        Eye(
            section.anterior_mm,
            section.posterior_mm,
            (1e-6 * mu1, 1e-6 * mu2),
            (alpha1, alpha2),
            eye.iop_mmhg * MPA_PER_MMHG,
            **hidden(name, rng),
        )
    )
    if name == "posterior_distortion":
        size = rng.choice([-1, 1]) * rng.uniform(0.03, 0.08)
        bottom = bottom + (bottom - top) * size / thickness
    if name == "segmentation_bias":
        size = rng.choice([-1, 1]) * rng.uniform(0.015, 0.03)
        step = np.array([0.0, size])
        top, bottom = top + step, bottom - step
    case = validated(
        CorneaCase,
        {
            "organ": "cornea",
            "reference": {"section": {}},
            "mesh": {"elements": 240},
            "model": {"prestress": "mulf"},
            "load": {"iop_mmhg": eye.iop_mmhg, "jet": {"pressure_kpa": 15}},
        },
    )
    fine = [_fine(line) for line in (section.anterior_mm, section.posterior_mm, top, bottom)]
    before, inner, after, inner_after = (drawn(line, rng) for line in fine)
    study = CorneaStudy(
        f"eye {number}",
        case,
        BOUNDS,
        {},
        Section(before, inner),
        Section(after, inner_after),
        {WINDOW: (-5.2, 5.2)},
        SEGMENTED,
    )
    return CorneaStudySource(study)


def _fine(line):
    """Return points 0.02 mm apart, as in a frame."""
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], round(arc[-1] / 0.02))
    return np.stack([np.interp(at, arc, line[:, k]) for k in range(2)], axis=1)


def diagnosed(source):
    """Diagnose a source in this process."""
    inverse, nominal = calibrate(source.inverse_problem(0, 0.0))
    found = [(e, scan_sensitivity(inverse, nominal, 0, e)) for e in source.effects]
    joined = [joined_sensitivity(e, [one]) for e, one in found]
    analysis = NominalAnalysis(inverse, nominal, [one for one in joined if one is not None])
    return diagnose_here(analysis, source.effects)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("--draw", type=int, required=True)
    wanted = parser.parse_args()
    results = wanted.results
    done = (
        {json.loads(line)["number"] for line in results.read_text().splitlines()}
        if results.exists()
        else set()
    )
    # One eye of every kind before the second of any.
    order = sorted(range(len(NAMES)), key=lambda n: (NAMES[:n].count(NAMES[n]), n))
    for number in order:
        if number in done:
            continue
        record = {"draw": wanted.draw, "number": number, "hidden": NAMES[number]}
        begin = time.perf_counter()
        try:
            verdict = diagnosed(source_of(wanted.draw, number)).verdict
        except ArithmeticError as error:
            record["failed"] = str(error)
        else:
            record |= {
                "verdict": verdict.kind,
                "primary": verdict.primary,
                "rivals": verdict.rivals,
                "gain": verdict.gain,
                "left_gain": verdict.left_gain,
                "absorbed": sorted(verdict.hidden),
            }
        record["seconds"] = round(time.perf_counter() - begin, 1)
        with results.open("a") as file:
            file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
