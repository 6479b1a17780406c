"""Arrays for pictures are consistent with each other and with their records."""

import numpy as np
import pytest

from palpate.storage.stored_arrays import load_arrays, save_arrays
from palpate.storage.values import Volume
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    interface_points,
    observe,
)
from palpate.workers.diagnosis.linearisation import Linearised
from palpate.workers.diagnosis.outcome.body_pictures import (
    bodies,
    causes,
    frame,
    local_means,
    loudest_place,
    overlap_rows,
)
from palpate.workers.diagnosis.outcome.residual_maps import CauseMap, local_mean
from palpate.workers.diagnosis.problem.prepared_parts import shapes


def egg(shift_mm=0.0, half_axis_x_mm=24.0):
    """Return fat with a gland in its middle, in voxels of 1.5 mm, moved along x."""
    z, y, x = (a * 1.5 for a in np.mgrid[-14:15, -14:15, -22:23])
    r = np.sqrt(((x - shift_mm) / half_axis_x_mm) ** 2 + (y / 15) ** 2 + (z / 15) ** 2)
    values = (r < 1).astype(np.uint8) + (r < 0.6)
    return Volume(values, (1.5, 1.5, 1.5), (-33.0, -21.0, -21.0))


@pytest.fixture(scope="module")
def points():
    return interface_points(egg(), (OUTLINE, GLANDULAR), 6.0, 0.0)


def test_labels_of_a_scan_share_a_box_and_a_frame():
    reference, observed = egg(), egg(3.0)
    moved = Volume(reference.values[:, :, 5:], (1.5, 1.5, 1.5), (-25.5, -21.0, -21.0))
    found = bodies(reference, [observed], {"before": [moved], "after": [observed]})
    seen, before, after = found["labels_0"]
    np.testing.assert_array_equal(seen, observed.values)
    np.testing.assert_array_equal(after, observed.values)
    np.testing.assert_array_equal(before[:, :, 5:], reference.values[:, :, 5:])
    np.testing.assert_array_equal(found["labels_0_frame"], frame(observed))


def test_shapes_match_the_interfaces():
    found = shapes(egg(), (OUTLINE, GLANDULAR))
    for name, half in (("outline", 24.0), ("glandular", 14.4)):
        vertices = found[f"shape_{name}_vertices"]
        assert np.ptp(vertices[:, 0]) == pytest.approx(2 * half, abs=2.0)
        assert found[f"shape_{name}_triangles"].max() == len(vertices) - 1


def test_overlap_rows_have_both_models_and_omit_empty_interfaces(points):
    observed = egg(3.0)
    predicted = {"before": [egg()], "after": [observed]}
    areas = [one.interface_mm2 for one in observe(observed, (OUTLINE, GLANDULAR)).distances]
    k = len(points)
    residuals = {"before": np.full((1, k), 0.5), "after": np.zeros((1, k))}
    noise = np.full((1, k), 0.2)
    rows = overlap_rows(
        ["40 N"], [areas], [observed], predicted, residuals, noise, points.interface
    )
    assert [(row.scan, row.interface) for row in rows] == [
        ("40 N", "outline"),
        ("40 N", "glandular"),
    ]
    for row in rows:
        assert row.after.jc == 1.0
        assert row.before.jc < row.reachable_jc < 1.0
        assert row.before.p95_mm == row.before.signed_mean_mm == 0.5
    outline_only = overlap_rows(
        ["40 N"],
        [areas],
        [observed],
        {"before": [egg()]},
        {"before": residuals["before"]},
        noise,
        np.zeros(k, np.int32),
    )
    assert [(row.interface, row.after) for row in outline_only] == [("outline", None)]


def test_local_means_are_computed_within_each_scan(points):
    k = len(points)
    residual = np.concatenate([np.full(k, 0.3), np.full(k, -0.1)])
    fit = Linearised(residual, np.zeros((2 * k, 0)), np.ones(0), np.zeros(0), 0.2 * np.eye(2 * k))
    found = local_means({"before": fit}, points)
    np.testing.assert_allclose(found["local_before"][0], 0.3)
    np.testing.assert_allclose(found["local_before"][1], -0.1)
    _, sd = local_mean(
        points.points,
        points.normals,
        points.interface,
        residual.reshape(2, k),
        0.04 * np.eye(2 * k),
    )
    np.testing.assert_allclose(found["local_before_sd"], sd)
    assert sd.max() <= 0.2


def test_cause_map_and_its_record_agree_on_the_place(tmp_path):
    places = np.array([[-10.0, 0.0, 0.0], [0.0, 0.0, 0.0], [10.0, 3.0, -1.0]])
    found = CauseMap(
        places,
        np.array([1.0, 9.0, -5.0]),
        np.array([0.1, 2.0, -0.8]),
        np.full(3, 0.3),
        np.array([True, False, True]),
        3.1,
    )
    record = loudest_place(found)
    # The second place has a larger score, but no scan shows it.
    assert record.score == -5.0
    assert (record.x_mm, record.y_mm, record.z_mm) == (10.0, 3.0, -1.0)
    assert (record.places, record.places_seen) == (3, 2)
    arrays = causes({"before": found}, egg())
    spacing, origin = arrays["cause_frame"]
    x, y, z = np.rint((places[2] - origin) / spacing).astype(int)
    # The centre of the voxel is within a millimetre of the place along every axis.
    assert arrays["cause_before"][z, y, x] == pytest.approx(-5.0, abs=1.5)
    save_arrays(tmp_path / "maps.zarr", arrays)
    kept, _ = load_arrays(tmp_path / "maps.zarr")
    np.testing.assert_array_equal(kept["cause_before"], arrays["cause_before"])
    assert np.isnan(kept["cause_before"]).any()
