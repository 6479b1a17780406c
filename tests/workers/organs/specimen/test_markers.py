"""Recordings of markers: windows, frames and noise estimated from repeats."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.comparison.observation.marker_tracking import (
    Recording,
    Scatter,
    component_covariance,
    misfit_mm,
    read_recording,
    rotation_to,
    scatter_of,
)

TIMES = np.arange(0, 5.01, 0.01)


def rotation(rng):
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize(
    ("window", "expected"), [((0, 1), 0.5), ((2.0, 4.0), 3.0), ((-1, 0), 4.5), ((-2, -1), 3.5)]
)
def test_averages_a_window_counted_from_the_start_or_the_end(window, expected):
    places = np.column_stack([TIMES, 0 * TIMES, 2 * TIMES])
    mean = Recording(TIMES, {"m": places}).mean("m", window)
    np.testing.assert_allclose(mean, [expected, 0, 2 * expected], atol=1e-9)


def test_averages_visible_frames_and_rejects_windows_without_any():
    places = np.ones((len(TIMES), 3))
    places[TIMES < 2] = np.nan
    recording = Recording(TIMES, {"m": places})
    np.testing.assert_array_equal(recording.mean("m", (1, 3)), [1, 1, 1])
    with pytest.raises(InputError, match="m was not seen between 0 and 1 s"):
        recording.mean("m", (0, 1))


def test_reads_the_named_columns_in_their_unit(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,Ax,Ay,Az,Bx,By,Bz\n0,0.001,2,3,4,5,6\n1,0.002,,3,4,5,6\n")
    found = read_recording(path, "t", "{marker}{axis}", ["A"], 1000.0)
    np.testing.assert_array_equal(found.times_s, [0, 1])
    np.testing.assert_array_equal(found.places_mm["A"][0], [1, 2000, 3000])
    assert np.isnan(found.places_mm["A"][1, 1])
    with pytest.raises(InputError, match=r"lacks the columns Cx, Cy, Cz; its columns are t, Ax"):
        read_recording(path, "t", "{marker}{axis}", ["C"], 1.0)


@pytest.mark.parametrize(
    ("text", "words"), [("t,Ax,Ay,Az\n", "no rows"), ("t,Ax,Ay,Az\n0,1,b,2\n", "not a number")]
)
def test_rejects_tables_without_numbers(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_recording(path, "t", "{marker}{axis}", ["A"], 1.0)


def test_recovers_the_rotation_from_markers_at_rest():
    rng = np.random.default_rng(3)
    body, turn = rng.uniform(-30, 30, (5, 3)), rotation(rng)
    seen = body @ turn + [100.0, -20.0, 7.0]
    np.testing.assert_allclose(rotation_to(body, seen), turn, atol=1e-12)
    np.testing.assert_allclose(misfit_mm(body, seen), 0, atol=1e-10)
    move = rng.standard_normal((4, 3))
    np.testing.assert_allclose((move @ turn) @ rotation_to(body, seen).T, move, atol=1e-12)


def test_rotation_to_a_mirror_image_is_proper():
    rng = np.random.default_rng(4)
    body = rng.uniform(-30, 30, (4, 3))
    assert np.linalg.det(rotation_to(body, body * [1, 1, -1])) == pytest.approx(1)


def test_rejects_a_frame_of_collinear_markers():
    line = np.outer([0.0, 1.0, 2.0], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="not on one line"):
        rotation_to(line, line)


@pytest.mark.parametrize(("own", "common"), [(0.1, 0.4), (0.3, 0.3), (0.2, 0.0)])
def test_recovers_own_and_common_noise_from_repeats(own, common):
    rng = np.random.default_rng(5)
    found = []
    for _ in range(600):
        shared = common * rng.standard_normal((2, 1, 3))
        repeats = shared + own * rng.standard_normal((2, 4, 3)) + rng.standard_normal((1, 4, 3))
        s = scatter_of(repeats)
        found.append((s.own_mm**2, s.common_mm**2))
    mean = np.mean(found, axis=0)
    assert mean[0] == pytest.approx(own**2, rel=0.06)
    # Negative variances are set to zero, a bias if there is no common noise.
    assert mean[1] == pytest.approx(common**2, rel=0.15, abs=0.3 * own**2)


def test_covariance_of_components_matches_hand_calculation():
    S = [Scatter(0.2, 0.5), Scatter(0.05, 0.0)]
    C = component_covariance(S, 2, [2, 4], Scatter(0.1, 0.3))
    assert C.shape == (12, 12)
    assert C[0, 0] == pytest.approx(0.2**2 / 2 + 0.5**2)  # half of the own variance
    assert C[0, 3] == pytest.approx(0.5**2)  # x of two markers
    assert C[0, 1] == C[0, 6] == 0  # no correlation with y or with another state
    assert C[6, 6] == pytest.approx(0.1**2 + 0.3**2)  # not below the stated noise
    assert np.linalg.eigvalsh(C).min() > 0
