"""Registration of the whole eye by its periphery."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section, generated_section
from palpate.workers.organs.cornea.tonometer_frames import register_periphery
from tests.workers.organs.cornea.frames.corvis_profiles import chord_motion

CORNEA = generated_section()


def dented(depth_mm: float) -> Section:
    surfaces = []
    for surface in (CORNEA.anterior_mm, CORNEA.posterior_mm):
        down = depth_mm * np.exp(-((surface[:, 0] / 1.6) ** 2))
        surfaces.append(surface - np.column_stack([0 * down, down]))
    return Section(*surfaces)


def test_finds_a_known_motion_in_spite_of_a_dent() -> None:
    middle = (0.0, float(CORNEA.anterior_mm[:, 1].max()))
    motion = RigidMotion((0.0, -0.25), 0.02, middle)
    found = register_periphery(CORNEA, motion.of_section(dented(1.0)), outer_mm=1.5)
    assert found.motion.shift_mm[1] == pytest.approx(-0.25, abs=1e-3)
    assert found.motion.tilt_rad == pytest.approx(0.02, abs=3e-4)
    assert found.rms_mm < 1e-3
    back = found.motion.inverse.of_section(motion.of_section(CORNEA))
    gap = np.interp(back.anterior_mm[:, 0], *CORNEA.anterior_mm.T) - back.anterior_mm[:, 1]
    assert np.abs(gap[10:-10]).max() < 2e-3


def test_the_stated_uncertainty_covers_the_error() -> None:
    rng = np.random.default_rng(1)
    z_scores = []
    for _ in range(40):
        # Errors of 5 um, correlated over half a millimetre.
        noisy = []
        for surface in (CORNEA.anterior_mm, CORNEA.posterior_mm):
            knots = np.arange(-6.5, 6.6, 0.5)
            error = np.interp(surface[:, 0], knots, 0.005 * rng.standard_normal(len(knots)))
            noisy.append(surface + np.column_stack([0 * error, error]))
        found = register_periphery(CORNEA, Section(*noisy), outer_mm=1.5)
        z_scores.append(
            [found.motion.shift_mm[1] / found.sd_y_mm, found.motion.tilt_rad / found.sd_tilt_rad]
        )
    spread = np.sqrt(np.mean(np.square(z_scores), axis=0))
    assert np.all((spread > 0.6) & (spread < 1.6))


def test_inverse_motion_cancels_and_the_chord_is_levelled() -> None:
    motion = RigidMotion((0.3, -0.2), 0.1, (1.0, 2.0))
    points = CORNEA.anterior_mm
    assert np.allclose(motion.inverse.of_points(motion.of_points(points)), points)
    tilted = motion.of_section(CORNEA)
    level = chord_motion(tilted).of_section(tilted)
    assert np.allclose(level.anterior_mm, CORNEA.anterior_mm, atol=1e-12)
    assert np.allclose(level.posterior_mm, CORNEA.posterior_mm, atol=1e-12)


def test_rejects_frames_with_too_little_overlap() -> None:
    with pytest.raises(InputError, match="share"):
        register_periphery(CORNEA, RigidMotion((9.0, 0.0)).of_section(CORNEA))
