"""The picture of a specimen: rings for measured points, crosses for predicted ones."""

import re
from dataclasses import replace

import numpy as np
import pytest

from palpate.service.report.diagnosis.specimen_pictures import movements, specimen_pictures
from palpate.storage.stored_arrays import Arrays
from palpate.workers.diagnosis.outcome.diagnosis_summary import MarkerResidual, MarkerState, Summary
from tests.service.report.diagnosis_at_hand import found as finished

NAN = float("nan")
PLACES = np.array([[0.0, 5.0, 10.0], [0.0, 5.0, 50.0], [20.0, 0.0, 30.0]])


def summary(*states: MarkerState) -> Summary:
    return replace(finished().summary, markers=states)


def state(name: str, along_mm: float, left_mm: float) -> MarkerState:
    """Return points that move along z by `along_mm`; the third was not measured."""
    seen = MarkerResidual("M", (0.0, 0.0, along_mm), (0.0, 0.0, left_mm), (0.0, 0.0, 0.0))
    hidden = MarkerResidual("M3", (NAN,) * 3, (NAN,) * 3, (NAN,) * 3)
    return MarkerState(name, None, (seen, seen, hidden))


def maps(states: int) -> Arrays:
    corners = np.array([[x, y, z] for x in (0, 20) for y in (0, 10) for z in (0, 60)], float)
    edges = np.stack([corners[:4], corners[4:]], axis=1)
    return {
        "marker_points": PLACES,
        "edges_rest": edges,
        "edges_before": np.stack([edges + np.array([0, 0, 1.0])] * states),
    }


def test_predicted_points_are_measurement_minus_residual() -> None:
    (one,) = movements(maps(1), summary(state("pulled", 3.0, -1.0)))
    np.testing.assert_array_equal(one.rest, PLACES[:2])
    for name, along in (("measured", 3.0), ("before", 2.0), ("after", 3.0)):
        np.testing.assert_array_equal(one.moved[name], [[0, 0, along]] * 2)
    assert one.misfit_mm == pytest.approx(1 / np.sqrt(3))


def test_picture_shows_points_edges_and_magnification() -> None:
    found = summary(state("a", 0.3, 0.0), state("b", 0.3, 0.1))
    shown, _ = specimen_pictures(maps(2), found, "plate tilt")
    assert shown.alt.startswith("b: ")  # the state that is farthest off comes first
    assert "drawn 10 times as large; the largest is 0.30 mm" in shown.alt
    wide = str(shown.svg).split("<svg")[1]
    assert len(re.findall(r'<circle[^>]*class="target"', wide)) == 1 + 2 * 2  # legend, two views
    assert len(re.findall(r'class="left-before"', wide)) == 1 + 2 * 2
    assert len(re.findall(r'class="(?:at-rest|left-before) edge"', wide)) == 4
    assert "measured_z_mm" in str(shown.table)


def test_flat_body_is_drawn_once() -> None:
    flat = {name: places * [1, 1, 0] for name, places in maps(1).items()}
    seen = MarkerResidual("M", (0.3, 0.0, NAN), (0.1, 0.0, NAN), (0.0, 0.0, NAN))
    (shown,) = specimen_pictures(flat, summary(MarkerState("a", None, (seen,) * 3)), "creep")
    wide = str(shown.svg).split("<svg")[1]
    assert len(re.findall(r'class="(?:at-rest|left-before) edge"', wide)) == 2


def test_no_picture_without_positions() -> None:
    assert list(specimen_pictures({}, summary(state("a", 1.0, 0.0)), "")) == []
    assert movements({"marker_points": PLACES[:1]}, summary(state("a", 1.0, 0.0))) == []
