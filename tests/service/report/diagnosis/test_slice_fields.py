"""Displacement and gap in slices of an egg with displacements proportional to its axes."""

import numpy as np
import pytest

from palpate.service.report.diagnosis.diagnosis_viewers import slice_fields
from palpate.storage.values import Volume
from tests.service.report.diagnosis_bodies_at_hand import HALF_AXES_MM, NOMINAL_MM, egg, found


def at(field: Volume, place_mm: tuple[float, float, float]) -> float:
    x, y, z = np.rint((np.array(place_mm) - field.origin_mm) / field.spacing_mm).astype(int)
    return float(field.values[z, y, x])


def test_fields_match_the_known_displacement_and_gap() -> None:
    maps = dict(found().maps)
    ends = NOMINAL_MM[0]
    maps["moved_before"] = maps["points"] * (ends / HALF_AXES_MM)[None, None]
    fields = slice_fields(maps, 0, {"before": egg(ends)}, ("before", "after"))
    assert set(fields) == {"displacement:before", "gap:before"}
    above, aside = (0.0, ends[1] - 1, 0.0), (ends[0] - 1, 0.0, 0.0)
    moved, gap = fields["displacement:before"], fields["gap:before"]
    assert at(moved, above) == pytest.approx(HALF_AXES_MM[1] - ends[1], abs=0.6)
    assert at(moved, aside) == pytest.approx(ends[0] - HALF_AXES_MM[0], abs=0.6)
    assert at(gap, above) == pytest.approx(1.5, abs=0.3)  # of the nominal model along y
    assert at(gap, aside) == pytest.approx(1.0, abs=0.3)
    assert np.isnan(at(gap, (0.0, 0.0, 0.0)))


def test_no_fields_without_displacements() -> None:
    assert slice_fields(found().maps, 0, {"before": egg(NOMINAL_MM[0])}, ("before",)) == {}
