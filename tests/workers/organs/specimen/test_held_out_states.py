"""States that were measured but held out: their ends move the body, the rest is compared."""

import json
from dataclasses import replace

import numpy as np
import pytest

import palpate
from palpate.service.diagnosis.diagnosis_console import experiment_lines
from palpate.service.report.diagnosis.diagnosis_page import render_diagnosis
from palpate.storage.errors import InputError
from palpate.workers.diagnosis.fits.gauss_newton import fit
from palpate.workers.diagnosis.outcome.summarising import summarise
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.organs.specimen.experiment_files import READER, files_of, read_experiment
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.organs.specimen.specimen_source import SpecimenSource
from palpate.workers.tasks.diagnosis_tasks import model_displacements, residual_maps
from tests.workers.organs.specimen.experiments import LOADS_N, described, record, write
from tests.workers.organs.specimen.test_measured_boundary import (
    ENDS,
    MEASURED,
    NODES,
    NU,
    YOUNG_KPA,
    experiment,
    grid,
    moved,
)
from tests.workers.organs.specimen.test_specimen_source import TURN, shown
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

SIZE = 1.5  # of the held-out state, in displacements of the first
INTERIOR = (grid()[:, 2] > 8) & (grid()[:, 2] < 40)
HEAD = "x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"


def held_out(folder, displacements=None, moves=MEASURED, **changes):
    """Write two fitted states and a held-out one with half as much strain again."""
    seen = moved(grid(), SIZE) if displacements is None else displacements
    rows = np.hstack([grid(), seen])
    np.savetxt(folder / "more.csv", rows, "%.17g", ",", header=HEAD, comments="")
    data = experiment(folder)
    data["predict"] = [{"name": "more", "moves": moves, "files": ["more.csv"]}]
    return write(folder, data | changes)


def predicted(path, restored=False):
    """Return the only prediction of an experiment, with the constants at their true values."""
    source = read_experiment(path)
    if restored:
        source = SpecimenSource.from_content(source.content)
    inverse = source.inverse_problem(NODES)
    z = np.log([YOUNG_KPA * 1e-3, 1 - 2 * NU])
    best = fit(inverse, unknowns(inverse.free, []), z, [None, None])
    (state,) = source.predictions(inverse, best)
    return state


def columns(state):
    """Return predicted displacements, standard deviations and measured displacements."""
    points = state.points
    return tuple(
        np.array([getattr(point, name) for point in points])
        for name in ("displacement_mm", "sd_mm", "measured_mm")
    )


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    return predicted(held_out(tmp_path_factory.mktemp("exact")))


def test_ends_move_as_measured_and_the_rest_is_compared(exact):
    """The exact answer is a homogeneous compression."""
    expected = moved(grid()[INTERIOR], SIZE)
    place, sd, seen = columns(exact)
    np.testing.assert_array_equal(seen, expected)
    assert np.abs(place - expected).max() < 0.003 * np.abs(expected).max()
    assert (sd > 0.001).all()
    assert sd.max() < 0.004  # 0.001 mm of noise at each point, and that of the ends
    agreement = exact.agreement
    assert agreement.components == agreement.within == 3 * INTERIOR.sum()
    assert agreement.rms_mm == pytest.approx(np.sqrt(((place - expected) ** 2).mean()))


def test_points_between_the_ends_are_not_used(exact, tmp_path):
    seen = moved(grid(), SIZE)
    seen[INTERIOR] += np.random.default_rng(1).normal(0, 0.1, (INTERIOR.sum(), 3))
    seen[np.flatnonzero(INTERIOR)[:7]] = np.nan
    other = predicted(held_out(tmp_path, seen))
    for before, after in zip(columns(exact)[:2], columns(other)[:2], strict=True):
        np.testing.assert_array_equal(after, before)
    np.testing.assert_array_equal(columns(other)[2], seen[INTERIOR])
    agreement = other.agreement
    assert agreement.components == 3 * (INTERIOR.sum() - 7)
    assert agreement.rms_mm == pytest.approx(0.1, rel=0.15)
    assert agreement.within < 0.1 * agreement.components


def test_points_of_the_ends_are_used(exact, tmp_path):
    seen = moved(grid(), SIZE)
    seen[grid()[:, 2] > 40] += [0.02, 0, 0]
    (place, *_), (before, *_) = columns(predicted(held_out(tmp_path, seen))), columns(exact)
    sideways = (place - before)[grid()[INTERIOR][:, 2] > 32, 0]
    assert sideways.min() > 0.01


def test_content_restores_a_held_out_state(exact, tmp_path):
    path = held_out(tmp_path)
    json.dumps(read_experiment(path).content.record)
    assert predicted(path, restored=True) == exact


def test_a_region_that_moves_as_measured_only_there_is_still_fitted(tmp_path):
    """Fitted states state the motion of their ends: all points but those of the held-out ends."""
    stated = [
        {"region": "bottom", "displacement_mm": [0, 0, 0]},
        {"region": "top", "displacement_mm": [0, 0, -0.17], "axes": ["z"]},
    ]
    path = held_out(tmp_path)
    data = described(field={"sd_mm": 0.001}, regions=ENDS)
    del data["markers"], data["holds"]
    data["states"] = [state | {"moves": stated, "forces": []} for state in data["states"]]
    data["predict"] = [{"name": "more", "moves": MEASURED, "files": ["more.csv"]}]
    source = read_experiment(write(path.parent, data))
    (state,) = source.spec.predict
    assert len(source.observed.points_mm) == len(grid())
    seen = source.observed.held_out_of(state, source.spec)
    np.testing.assert_array_equal(np.isfinite(seen).all(axis=1), INTERIOR)
    ends = source.observed.boundary_of(state, source.spec)
    assert sum(len(field.points_mm) for field in ends.values()) == (~INTERIOR).sum()


def test_markers_of_a_held_out_state_are_compared(tmp_path):
    data = described()
    for state in data["states"]:
        record(tmp_path / state["files"][0], shown(LOADS_N[state["name"]]), TURN)
    record(tmp_path / "heavier.csv", shown(0.05), TURN)
    data["predict"][0]["files"] = ["heavier.csv"]
    source = read_experiment(write(tmp_path, data))
    (state,) = source.spec.predict
    seen = source.observed.held_out_of(state, source.spec)
    np.testing.assert_allclose(seen, shown(0.05), atol=1e-6)
    np.testing.assert_allclose(source.observed.moved_mm[1], shown(0.03), atol=1e-6)


def test_lists_recordings_of_held_out_states(tmp_path):
    path = held_out(tmp_path)
    assert [file.name for file in files_of(read_spec(path), path)][-1] == "more.csv"
    text = dict(READER.understood(path))["to predict: more"]
    assert text == "bottom moved as measured; top moved as measured; more.csv"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"predict": [{"name": "more", "moves": MEASURED}]},
            "state more: bottom moves as measured, but there is no recording: give files",
        ),
        (
            {"predict": [{"name": "more", "moves": MEASURED, "files": ["none.csv"]}]},
            "names none\\.csv, which is not in",
        ),
        (
            {
                "predict": [
                    {
                        "name": "more",
                        "moves": [*MEASURED, {"region": "face", "measured": True}],
                        "files": ["more.csv"],
                    }
                ],
                "regions": ENDS | {"face": {"plane": {"axis": "z", "at_mm": 48}}},
            },
            "region face moves as measured in the state more, but 0 points of the field",
        ),
    ],
)
def test_rejects_ends_that_were_not_measured(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        read_experiment(held_out(tmp_path, **change))


def test_rejects_other_points_in_a_held_out_state(tmp_path):
    path = held_out(tmp_path)
    lines = (tmp_path / "more.csv").read_text().splitlines()
    (tmp_path / "more.csv").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(InputError, match=r"more\.csv lists different points"):
        read_experiment(path)


@pytest.mark.slow
def test_a_diagnosis_shows_the_measured_displacements(tmp_path):
    """From the files to the console and the page."""
    source = read_experiment(held_out(tmp_path))
    store = diagnosed_store(source, tmp_path / "store", NODES, effects=["stiffness_gradient"])
    diagnosis = diagnosis_in(store)
    summary = summarise(diagnosis, store.effects, source.name)
    drawn, summary = source.describe(diagnosis, model_displacements(diagnosis, map), summary, None)
    count = 3 * INTERIOR.sum()
    said = f"measured: {count} of {count} components within two standard deviations"
    lines = list(experiment_lines(summary))
    assert any(line.strip().startswith(said) for line in lines)
    (first,) = (line for line in lines if line.startswith(f"  {source.observed.names[0]}: "))
    assert "; measured −0.0084, −0.0084, −0.0600 mm" in first
    maps = residual_maps(diagnosis) | drawn
    page = render_diagnosis(palpate.Diagnosis(summary, maps, tuple(source.scans)))
    assert f"more: {said}" in page
    assert "<th>Measured, mm</th>" in page
    bare = replace(summary.predictions[0].points[0], measured_mm=None)
    unmeasured = replace(summary.predictions[0], points=(bare,))
    assert unmeasured.agreement is None
