"""Positions of drawn contours."""

import numpy as np

from palpate.workers.organs.cornea.cornea_findings import overlay
from palpate.workers.organs.cornea.tonometer_frames import Frame


def test_line_colours_only_the_pixels_it_crosses() -> None:
    frame = Frame(np.linspace(0, 100, 40 * 60).reshape(40, 60), (0.01, 0.02), (2.0, 5.0))
    line = frame.to_mm(np.array([10.0, 50.0]), np.array([20.0, 20.0]))
    assert np.allclose(frame.to_pixels(line), [[10, 20], [50, 20]])
    picture = overlay(frame, [(line, (255, 0, 0))])
    plain = overlay(frame, [])
    assert picture.shape == (40, 60, 3)
    assert np.all(picture[20, 10:51] == [255, 0, 0])
    changed = np.any(picture != plain, axis=2)
    assert set(np.flatnonzero(changed.any(axis=1)).tolist()) == {20}
    outside = overlay(frame, [(line + np.array([10.0, 0.0]), (255, 0, 0))])
    assert np.array_equal(outside, plain)
