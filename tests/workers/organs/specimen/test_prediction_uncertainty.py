"""A prediction is uncertain by what the fit leaves and by the scatter between recordings."""

import numpy as np
import pytest

from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.organs.specimen.experiment_files import read_experiment
from tests.cases.bench import bench_cases
from tests.cases.bench.test_fields import FURTHER, SD_MM, points, table
from tests.workers.organs.specimen.test_sheets import (
    NODES,
    STRETCHES,
    THICKNESS,
    WIDTH,
    described,
    with_forces,
    written,
)

MU_MPA, SD_N = 0.08 / 3, 0.001
FURTHEST = 1.4


def force_n(stretch, stiffening):
    """Return the force on a strip of W = mu / (2 b) (exp(b (I1 - 3)) - 1), incompressible."""
    first = stretch**2 + 2 / stretch
    stress = MU_MPA * (stretch - stretch**-2) * np.exp(stiffening * (first - 3))
    return float(stress * WIDTH * THICKNESS)


def predicted(path):
    """Return the prediction of the nominal model, which is neo-Hookean."""
    source = read_experiment(path)
    inverse, fit = calibrate(source.inverse_problem(NODES), None)
    (state,) = source.predictions(inverse, fit)
    return state


@pytest.mark.parametrize("stiffening", [0.5, 1.0, 2.0, 3.0])
def test_force_beyond_a_stiffening_law_is_within_two_deviations(tmp_path, stiffening):
    """Fitted up to a stretch of 1.2 and predicted at 1.4; displacements are those of any law."""
    data = with_forces(described(), lambda stretch: force_n(stretch, stiffening))
    (force,) = predicted(written(tmp_path, data)).reactions
    off = force_n(FURTHEST, stiffening) - force.force_n
    assert off > 0.1 * force.force_n
    assert 0.5 * off < force.sd_n < 1.5 * off


def test_force_of_the_true_law_is_uncertain_by_its_noise(tmp_path):
    state = predicted(written(tmp_path, described()))
    (force,) = state.reactions
    read = [force_n(stretch, 0.0) for stretch in STRETCHES.values()]
    truth = force_n(FURTHEST, 0.0)
    # The stiffness from both readings, and the noise of one more reading.
    noise = SD_N * np.hypot(truth / np.linalg.norm(read), 1.0)
    assert noise < force.sd_n < 1.5 * noise
    assert abs(force.force_n - truth) < 2 * force.sd_n
    sd = np.array([point.sd_mm for point in state.points])[:, :2]
    assert sd.min() > 0.0099
    assert sd.max() < 0.015


def test_force_is_known_no_better_than_displacements_are_explained(tmp_path):
    """In one state a fitted stiffness leaves no residual of the force; a grip slips by 30 %."""
    data = described()
    data["states"] = data["states"][1:]
    path = written(tmp_path, data, slip=0.3)
    (force,) = predicted(path).reactions
    assert force.sd_n == pytest.approx(0.3 * force.force_n, rel=0.25)


def test_displacement_is_uncertain_by_the_scatter_between_repeats(tmp_path):
    """Two repeats, 5 % more and 5 % less than the mean, and 1.5 times their load."""
    data = bench_cases.described(field={"sd_mm": SD_MM}, predict=[FURTHER])
    del data["markers"]
    moved = bench_cases.motion(points())
    path = bench_cases.write(tmp_path, data, table(1.05 * moved), table(0.95 * moved))
    source = read_experiment(path)
    inverse, fit = calibrate(source.inverse_problem(500), None)
    (state,) = source.predictions(inverse, fit)
    sd = np.array([point.sd_mm for point in state.points])
    further = bench_cases.motion(points(), 1.5 * bench_cases.FORCE_N)
    between = 0.05 * np.sqrt(2) * np.sqrt((further**2).mean())
    assert np.sqrt((sd**2).mean()) == pytest.approx(between, rel=0.3)
    assert sd.min() > 0.9 * between
