"""Arrows of a bench experiment: directions, lengths, and absence."""

import re

import numpy as np
import pytest

from palpate.service.report.diagnosis.specimen_pictures import (
    Misfits,
    arrow_magnification,
    arrow_pictures,
    misfits_of,
)
from palpate.storage.stored_arrays import Arrays
from palpate.workers.diagnosis.problem.inverse_problem import FORCE

POINTS = np.array([[x, y, z] for x in (0.0, 4.0) for y in (0.0, 8.0) for z in (0.0, 20.0, 40.0)])


def maps_of(before: np.ndarray, after: np.ndarray | None = None) -> Arrays:
    """Return the maps of a diagnosis: components of points, then one load cell."""
    scans = len(before)
    reading = np.full((scans, 1), 77.0)
    maps = {
        "points": np.vstack([np.repeat(POINTS, 3, axis=0), [[1e6, 0.0, 0.0]]]),
        "interface": np.append(np.tile([0, 1, 2], len(POINTS)), FORCE),
        "before": np.hstack([before.reshape(scans, -1), reading]),
    }
    if after is not None:
        maps["after"] = np.hstack([after.reshape(scans, -1), reading])
    return maps


def left(states: int, along: tuple[float, float, float]) -> np.ndarray:
    return np.tile(np.array(along), (states, len(POINTS), 1))


def test_ignores_load_cells() -> None:
    before = np.random.default_rng(1).normal(size=(2, len(POINTS), 3))
    found = misfits_of(maps_of(before, 0.5 * before))
    assert np.array_equal(found.points, POINTS)
    assert np.array_equal(found.before, before)
    assert found.after is not None
    assert np.array_equal(found.after, 0.5 * before)


@pytest.mark.parametrize(
    ("longest", "noise", "times"), [(0.01, 0.0, 200.0), (9.0, 0.0, 0.5), (1e-6, 0.1, 20.0)]
)
def test_enlarges_arrows_but_not_noise(longest: float, noise: float, times: float) -> None:
    misfits = Misfits(POINTS, left(1, (0.0, longest, 0.0)), None)
    assert arrow_magnification(misfits, noise) == pytest.approx(times)


def test_arrow_ends_at_predicted_point() -> None:
    before, after = left(1, (0.0, 0.1, -0.2)), left(1, (0.0, -0.05, 0.0))
    (shown,) = arrow_pictures(maps_of(before, after), ["pulled"], "plate tilt", 0.01)
    assert "pulled" in shown.alt
    wide = str(shown.svg).split("<svg")[1]
    arrows = r'<path d="M\S+ [\d.]+l(\S+) ([-\d.]+)[^"]*" class="left-(before|after)"'
    paths = re.findall(arrows, wide)  # of two models in two views, z to the right, y or x up
    (dx, dy, _), (later_dx, later_dy, _) = paths[:2]
    assert [which for _, _, which in paths] == 2 * ["before", "after"]
    assert float(dx) == pytest.approx(2 * float(dy), rel=0.03)
    assert float(later_dx) == 0.0
    assert float(dy) < 0 < float(later_dy)  # upwards, and pixels grow downwards


def test_draws_states_with_largest_misfit() -> None:
    before = left(8, (0.1, 0.0, 0.0)) * np.arange(1, 9)[:, None, None]
    names = [f"step {n}" for n in range(1, 9)]
    shown = list(arrow_pictures(maps_of(before), names, "", 0.01))
    assert [picture.alt.split(":")[0] for picture in shown] == names[2:]


def test_draws_no_arrows_for_few_points() -> None:
    maps = maps_of(left(1, (0.1, 0.0, 0.0)))
    few = np.r_[0:9, -1]
    maps = {
        name: values[..., few] if name == "before" else values[few] for name, values in maps.items()
    }
    assert not list(arrow_pictures(maps, ["pulled"], "", 0.01))


def test_sheet_is_drawn_once() -> None:
    flat = POINTS * [0.0, 1.0, 1.0]
    maps = maps_of(left(1, (0.0, 0.1, 0.0)))
    maps["points"][:-1] = np.repeat(flat, 3, axis=0)
    (shown,) = arrow_pictures(maps, ["pulled"], "", 0.01)
    wide = str(shown.svg).split("<svg")[1]
    assert "z, mm" in wide
    assert "y, mm" in wide
    assert "x, mm" not in wide
