"""Fields of displacements: missing components, fitted intervals, predictions, messages."""

import io
import time
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from palpate.service.diagnosis.diagnosis_console import DiagnosisProgress
from palpate.service.diagnosis.diagnosis_run import Step
from palpate.service.report.diagnosis.specimen_pictures import misfits_of
from palpate.storage.errors import InputError
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.organs.specimen.mesh_and_boundary_errors import support_force_n, supported
from palpate.workers.organs.specimen.observed_and_predicted import unexplained_at, unexplained_sd
from palpate.workers.organs.specimen.specimen_checks import outside_intervals
from palpate.workers.organs.specimen.specimen_effects import NOT_SIMULATED
from palpate.workers.organs.specimen.specimen_source import SpecimenSource
from palpate.workers.tasks.diagnosis_sources import check_source
from palpate.workers.tasks.diagnosis_store import JointFitRecord
from tests.cases.bench.bench_cases import FORCE_N, NU, SIZE, YOUNG_MPA, described, motion, write

NODES = 500
HEAD = ("x_mm", "y_mm", "z_mm", "ux_mm", "uy_mm", "uz_mm")
SD_MM = 0.02


def points():
    """Return points away from the loaded face, whose nodes carry equal forces."""
    axes = [np.linspace(5, 25, 3), np.linspace(5, 25, 3), np.linspace(5, 35, 3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def table(moved, head=HEAD):
    every = dict(zip(HEAD, np.hstack([points(), moved]).T, strict=True))
    lines = zip(*(every[name] for name in head), strict=True)
    text = [",".join("" if np.isnan(v) else f"{v:.7f}" for v in line) for line in lines]
    return "\n".join([",".join(head), *text]) + "\n"


def experiment(folder, moved=None, head=HEAD, nu=NU, **changes):
    """Write the block that is pulled with 18 N, measured at 27 points."""
    data = described(field={"sd_mm": SD_MM}, **changes)
    del data["markers"]
    data["materials"]["gel"]["nu"] = nu
    content = table(motion(points()) if moved is None else moved, head)
    return write(folder, data, content, content)


FURTHER = {"name": "further", "forces": [{"region": "top", "force_n": [0, 0, 1.5 * FORCE_N]}]}


def test_unmeasured_component_is_not_compared(tmp_path):
    source = read_experiment(experiment(tmp_path, head=HEAD[:-1], predict=[FURTHER]))
    check_source(source)
    assert source.observed.notes == ("uz_mm was not measured and is not compared.",)
    assert len(source.observed.covariance) == 2 * len(points())
    inverse, fit = calibrate(source.inverse_problem(NODES), None)
    assert len(inverse.points) == 2 * len(points())
    assert fit.values()["E"] == pytest.approx(YOUNG_MPA, rel=0.02)
    assert unexplained_sd(inverse, fit).max() < SD_MM / 2
    (state,) = source.predictions(inverse, fit)
    moved = np.array([point.displacement_mm for point in state.points])
    np.testing.assert_allclose(moved[:, :2], motion(points(), 27.0)[:, :2], atol=2 * SD_MM)
    assert np.isnan(moved[:, 2]).all()


def test_missing_values_are_not_compared(tmp_path):
    moved = motion(points())
    moved[3, 2] = moved[7] = np.nan
    source = read_experiment(experiment(tmp_path, moved))
    assert source.observed.notes[0].startswith("2 of 27 points lack a component")
    again = SpecimenSource.from_content(source.content)
    np.testing.assert_array_equal(again.observed.measured, source.observed.measured)
    assert source.observed.measured.sum() == 3 * 26 - 1
    assert "7" not in source.observed.names
    assert again.observed.notes == source.observed.notes


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        (np.inf, "line 4: a displacement is infinite"),
        (None, "lacks the columns ux_mm, uy_mm, uz_mm"),
    ],
)
def test_rejects_a_field_without_displacements(tmp_path, cell, words):
    moved = motion(points())
    moved[2, 1] = moved[2, 1] if cell is None else cell
    with pytest.raises(InputError, match=words):
        read_experiment(experiment(tmp_path, moved, HEAD[:3] if cell is None else HEAD))


def test_rejects_a_field_in_metres(tmp_path):
    path = experiment(tmp_path, motion(points()) / 1000)
    with pytest.raises(InputError, match="Nothing was measured"):
        check_source(read_experiment(path))
    for name in ("a.csv", "b.csv"):
        rows = np.hstack([points() / 1000, motion(points())])
        np.savetxt(tmp_path / name, rows, delimiter=",", header=",".join(HEAD), comments="")
    with pytest.raises(InputError, match="check whether they are in metres"):
        check_source(read_experiment(path))


def test_region_moves_along_measured_axes_only(tmp_path):
    moves = [{"region": "end", "measured": True}]
    data = described()
    end = {"box_mm": {"lower": [0, 0, 30], "upper": [30, 30, 60]}}
    changes = {
        "regions": data["regions"] | {"end": end},
        "states": [data["states"][0] | {"moves": moves, "forces": []}],
    }
    path = experiment(tmp_path, head=HEAD[:-1], **changes)
    with pytest.raises(InputError, match="region end moves as measured, but uz_mm was not"):
        read_experiment(path)
    moves[0]["axes"] = ["x", "y"]
    source = read_experiment(experiment(tmp_path, head=HEAD[:-1], **changes))
    assert len(source.observed.boundary_mm) == 9


def test_interval_of_nu_bounds_the_fit(tmp_path):
    source = read_experiment(experiment(tmp_path, nu=[0.2, 0.4]))
    free = unknowns(source.free, [])
    ends = (1 - np.exp(np.array([free.upper[1], free.lower[1]]))) / 2
    np.testing.assert_allclose(ends, [0.2, 0.4])
    # The interval of E is a prior, which data may overrule.
    assert np.exp(free.upper[0]) > 2 * 0.8


@pytest.mark.slow
def test_fit_stops_at_the_end_of_an_interval(tmp_path):
    source = read_experiment(experiment(tmp_path, nu=[0.2, 0.4]))
    _, fit = calibrate(source.inverse_problem(NODES), None)
    assert (1 - fit.values()["compressibility"]) / 2 == pytest.approx(0.4, abs=1e-6)
    assert "nu is at the end of its interval" in outside_intervals(source.spec, fit.values())[-1]


def test_mesh_correction_applies_to_forces_only(tmp_path):
    loads = read_experiment(experiment(tmp_path))
    assert loads.part_of_compliance(NODES) < 1
    assert loads.finer(NODES) is None
    data = described()
    move = {"moves": [{"region": "top", "displacement_mm": [0, 0, 6]}], "forces": []}
    moved = read_experiment(experiment(tmp_path, states=[data["states"][0] | move]))
    assert moved.part_of_compliance(NODES) == 1
    assert moved.finer(2 * NODES) is not None


@pytest.mark.slow
def test_prediction_includes_the_unexplained_residual(tmp_path):
    """A field with a bulge that no constant explains, and a state with 1.5 times the load."""
    wrong = 0.3 * np.sin(points() / 6)
    source = read_experiment(experiment(tmp_path, motion(points()) + wrong, predict=[FURTHER]))
    inverse, fit = calibrate(source.inverse_problem(NODES), None)
    left = fit.residual(inverse).reshape(-1, 3)
    expected = np.sqrt((left**2).mean(axis=0) - SD_MM**2)
    found = unexplained_sd(inverse, fit).reshape(-1, 3)
    np.testing.assert_allclose(found[0], expected, rtol=0.01)
    (state,) = source.predictions(inverse, fit)
    sd = np.array([point.sd_mm for point in state.points])
    moved = np.array([point.displacement_mm for point in state.points])
    truth = motion(points(), 1.5 * FORCE_N) + 1.5 * wrong
    assert (sd >= found).all()
    assert (np.abs(moved - truth) < 1.645 * sd).mean() > 0.8


def test_prediction_extrapolates_a_trend_of_the_residuals(tmp_path):
    """A field whose error grows with the square of the load, in two states and a larger one."""
    sizes, wrong = (0.5, 1.0), 0.3 * np.sin(points() / 6)
    source = read_experiment(experiment(tmp_path, predict=[FURTHER]))
    inverse, fit = calibrate(source.inverse_problem(NODES), None)
    one, (scan,) = fit.predictions[0], inverse.scans
    at = inverse.points
    two = [
        replace(
            one,
            points=at.points + size * (one.points - at.points),
            residual=size**2 * wrong.ravel(),
        )
        for size in sizes
    ]
    doubled = replace(
        inverse,
        scans=[scan, scan],
        bias=np.zeros(2 * len(at)),
        covariance=np.kron(np.eye(2), inverse.covariance),
    )
    moved = 1.5 * ((one.points - at.points) * at.normals).sum(axis=1)
    found = unexplained_at(doubled, replace(fit, predictions=tuple(two)), moved).reshape(-1, 3)
    # The parabola through 0 and both states weighs them by -3 and 3, and so their noise.
    noise = np.diag(inverse.covariance).reshape(-1, 3)
    expected = np.sqrt((1.5**4 * wrong**2 - (3**2 + 3**2) * noise).mean(axis=0))
    np.testing.assert_allclose(found[0], expected, rtol=1e-6)


def test_arrows_use_the_measured_components():
    measured = np.array([[True, True, True], [True, False, True], [False, True, True]])
    at, axis = np.nonzero(measured)
    places = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    left = np.arange(1.0, 8.0)
    maps = {"interface": axis.astype(np.int32), "points": places[at], "before": left[None]}
    found = misfits_of(maps)
    np.testing.assert_array_equal(found.points, places)
    np.testing.assert_array_equal(found.before[0], [[1, 2, 3], [4, 0, 5], [0, 6, 7]])


def test_warns_of_supports_that_carry_part_of_a_small_force(tmp_path):
    data = described()
    move = {
        "forces": [],
        "moves": [{"region": "top", "displacement_mm": [0, 0, 6], "axes": ["z"]}],
        "reactions": [{"region": "top", "axis": "z", "force_n": 0.04, "sd_n": 0.001}],
    }
    holds = [hold for hold in data["holds"] if hold["axes"] != ["x"]]
    states = [data["states"][0] | move]
    source = read_experiment(experiment(tmp_path, states=states, holds=holds))
    inverse = source.inverse_problem(NODES)
    problem = source.problem(source.spec.states[0])({"E": YOUNG_MPA})
    nodes = inverse.model.finest.nodes
    moved = np.vstack([0.2 * nodes * [1, 0, 0], np.zeros((1, 3))])  # a load cell after the nodes
    # Springs of 5e-9 N/mm^4 on 54,000 mm^3 that move by 3 mm on average.
    expected = 5e-9 * np.prod(SIZE) * 3
    held = support_force_n(inverse.model.finest, problem, moved[:-1])
    assert held == pytest.approx(expected, rel=0.02)
    (text,) = supported(inverse, [problem], source.spec.states, [moved])
    assert "carry 0.00081 N in the state pulled, 2 % of the largest force" in text
    state = source.spec.states[0]
    reaction = state.reactions[0].model_copy(update={"force_n": 18.0})
    strong = state.model_copy(update={"reactions": (reaction,)})
    assert supported(inverse, [problem], [strong], [moved]) == ()


def test_causes_without_an_effect_concern_the_bench():
    text = " ".join(" ".join(pair) for pair in NOT_SIMULATED).lower()
    assert not any(word in text for word in ("gland", "fat", "nipple", "skin", "breast", "scan"))


def lines_until(file: io.StringIO, expected: str, count: int = 1) -> list[str]:
    """Wait until a line was printed so many times; return all lines, without their times."""
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        lines = [line.partition("] ")[2] for line in file.getvalue().splitlines()]
        if lines.count(expected) >= count:
            break
        time.sleep(0.01)
    return lines


def test_long_step_prints_progress_repeatedly():
    file, every_s, begun = io.StringIO(), 0.05, time.monotonic()
    with DiagnosisProgress(Console(file=file), every_s=every_s):
        lines = lines_until(file, "still starting", 4)
    assert set(lines) == {"still starting"}
    assert 4 <= len(lines) <= (time.monotonic() - begun) / every_s


def test_long_fits_print_their_iterations():
    file = io.StringIO()
    fitted = JointFitRecord(True, 1.0, 0.0, 0.0, True, 3)
    with DiagnosisProgress(Console(file=file, width=200), every_s=0.05) as progress:
        progress(Step("refits", 0, 3))
        progress.iterated("plate_tilt", 2)
        progress.iterated("plate_friction", 1)
        fits = "plate_friction iteration 1, plate_tilt iteration 2"
        both = f"still refitting the suspects: 0 of 3, {fits}"
        assert both in lines_until(file, both)
        progress(Step("refits", 1, 3, "plate_tilt", fitted))
        one = "still refitting the suspects: 1 of 3, plate_friction iteration 1"
        assert one in lines_until(file, one)
        progress(Step("refits", 0, 1))
        assert "still refitting the suspects" in lines_until(file, "still refitting the suspects")
