"""Half-millimetre label volumes in ../shared/reference/gap-open, if available."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
    observe,
    residual,
)

CASES = Path(__file__).parents[5] / "shared" / "reference" / "gap-open"
BOTH = (OUTLINE, GLANDULAR)

pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not available")


@pytest.fixture(scope="module")
def reference():
    return read_volume_file(CASES / "dev_0fb9b9" / "reference.nrrd")


@pytest.fixture(scope="module")
def points(reference):
    return interface_points(reference, BOTH, spacing_mm=3.0, wall_margin_mm=5.0)


@pytest.mark.slow
def test_reference_has_no_residual_against_itself(reference, points):
    r, _ = residual(points.points, points, observe(reference, BOTH))
    assert abs(r.mean()) < 0.003 and r.std() < 0.015 and np.abs(r).max() < 0.25
    counts = np.bincount(points.interface)
    assert counts[0] > 2000 and counts[1] > 3000
    assert points.points[:, 2].min() > 3.0


def test_true_displacement_leaves_only_segmentation_noise(points):
    truth = np.load(CASES / "dev_0fb9b9" / "truth.npz")
    field = RBFInterpolator(truth["nodes"], truth["u40"], neighbors=40, kernel="thin_plate_spline")
    outline = points.of(np.flatnonzero(points.interface == 0))
    deformed = read_volume_file(CASES / "dev_0fb9b9" / "deformed_40N.nrrd")
    still, _ = residual(outline.points, outline, observe(deformed, (OUTLINE,)))
    r, _ = residual(outline.points + field(outline.points), outline, observe(deformed, (OUTLINE,)))
    # Each of the two scans has errors of 0.3 mm (see its case); the body was compressed by 30 mm.
    assert abs(still).mean() > 3
    assert abs(r.mean()) < 0.06
    assert r.std() == pytest.approx(0.3 * np.sqrt(2), rel=0.1)
