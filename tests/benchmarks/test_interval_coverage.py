"""The benchmark of the coverage of quotable intervals."""

from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from tests.benchmarks.interval_coverage import KINDS, Interval, intervals_of, moved, table

FAT = int(Tissue.FAT)


def bar() -> Volume:
    """Return a bar of 12 x 4 x 2 mm centred on the origin."""
    values = np.full((1, 2, 6), FAT, np.uint8)
    return Volume(values, (2.0, 2.0, 2.0), (-5.0, -1.0, 0.0))


def middle_mm(volume: Volume) -> np.ndarray:
    z, y, x = np.nonzero(volume.values)
    index = np.stack([x, y, z], axis=1)
    return np.asarray((np.asarray(volume.origin_mm) + index * volume.spacing_mm).mean(axis=0))


def test_labels_are_shifted_scaled_mirrored_and_turned() -> None:
    assert np.allclose(middle_mm(moved(bar(), KINDS["shift 4 mm along x"])), (4, 0, 0))
    larger = moved(bar(), KINDS["scale 5 %"])
    assert larger.spacing_mm == pytest.approx((2.1, 2.1, 2.1))
    assert np.allclose(middle_mm(larger), 0)
    assert np.array_equal(moved(bar(), KINDS["mirrored"]).values, bar().values[::-1])
    turned = moved(bar(), KINDS["turn 3 degrees"])
    assert np.allclose(middle_mm(turned), 0, atol=0.1)
    assert np.count_nonzero(turned.values) == 12


def test_coverage_counts_quotable_intervals_only() -> None:
    shown = Interval("clean", 1, "E_fat", 10.0, 10.1, 9.9, 10.3, True, ())
    missed = Interval("clean", 1, "eta_fat", 10.0, 12.0, 11.0, 13.0, True, ())
    withheld = Interval("clean", 1, "E_glandular", 10.0, 12.0, None, None, False, ("a bound (1)",))
    assert "| clean | 3 | 2 | 1 (50 %) | a bound |" in table([shown, missed, withheld])


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_quotable_intervals_of_two_studies_cover_the_truth(tmp_path: Path) -> None:
    clean = intervals_of("clean", 1, tmp_path)
    shifted = intervals_of("shift 4 mm along x", 1, tmp_path)
    quotable = [one for one in clean if one.quotable]
    assert {one.constant for one in quotable} >= {"E_fat", "E_glandular"}
    assert all(one.holds for one in quotable)
    assert not any(one.quotable for one in shifted)
    assert all(any("place of the scan" in r for r in one.reasons) for one in shifted)
