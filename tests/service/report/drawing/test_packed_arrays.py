"""Packed arrays are unpacked without change."""

import base64
import json
import re
import zlib
from typing import Any

import numpy as np
import pytest

from palpate.service.report.page.page_elements import (
    TYPES,
    body_box_mm,
    packed,
    packed_volume,
    script,
    thinned,
)
from palpate.service.report.page.page_viewers import BodyScan, BodySurface, body_viewer
from palpate.storage.values import FloatArray, Volume
from palpate.workers.mechanics.fem.loads_and_regions import Pressed


def unpacked(told: dict[str, Any]) -> np.ndarray:
    raw = zlib.decompress(base64.b64decode(told["data"]))
    return np.frombuffer(raw, TYPES[told["type"]])


def told_by(element: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="[\w-]+">(.*)</script>', element)
    assert found is not None
    return dict(json.loads(found[1]))


@pytest.mark.parametrize("kind", TYPES)
def test_packed_arrays_round_trip(kind: str) -> None:
    values = np.arange(200).reshape(4, 5, 10)
    np.testing.assert_array_equal(unpacked(packed(values, kind)), values.ravel())


def test_escapes_closing_tags() -> None:
    element = script("told", {"name": "</script><script>alert(1)//"})
    assert element.count("</script>") == 1
    assert told_by(element) == {"name": "</script><script>alert(1)//"}


def test_large_volume_is_subsampled_in_place() -> None:
    values = np.zeros((20, 30, 40), np.uint8)
    values[10:14, 12:16, 20:24] = 2
    volume = Volume(values, (1.0, 2.0, 3.0), (5.0, 6.0, 7.0))
    thin = thinned(volume, 4000)
    assert thin.values.shape == (10, 15, 20)
    assert thin.spacing_mm == (2.0, 4.0, 6.0)
    (z, y, x) = (int(a[0]) for a in np.nonzero(thin.values == 2))
    assert thin.origin_mm[0] + x * thin.spacing_mm[0] == 5.0 + 20 * 1.0
    assert thin.origin_mm[1] + y * thin.spacing_mm[1] == 6.0 + 12 * 2.0
    assert thin.origin_mm[2] + z * thin.spacing_mm[2] == 7.0 + 10 * 3.0
    assert thinned(volume, 24000) is volume


def test_the_box_of_a_body_ends_at_its_voxel_faces() -> None:
    values = np.zeros((4, 5, 6), np.uint8)
    values[1:3, 2, 3:5] = 1
    low, high = body_box_mm(Volume(values, (1.0, 2.0, 4.0), (0.0, 0.0, 0.0)))
    assert low == (2.5, 3.0, 2.0)
    assert high == (4.5, 5.0, 10.0)


def test_breast_labels_are_compact() -> None:
    """160 voxels along each axis, a gland of 200 blobs: less than half a megabyte."""
    rng = np.random.default_rng(1)
    z, y, x = np.ogrid[-1:1:160j, -1:1:160j, -1:1:160j]
    values = ((x**2 + y**2 + z**2) < 0.9).astype(np.uint8)
    for cx, cy, cz in rng.uniform(-0.5, 0.5, (200, 3)):
        i, j, k = (slice(int(80 + 80 * c) - 8, int(80 + 80 * c) + 8) for c in (cz, cy, cx))
        near = (x[..., k] - cx) ** 2 + (y[:, j] - cy) ** 2 + (z[i] - cz) ** 2
        values[i, j, k][near < 0.0064] = 2
    assert len(json.dumps(packed_volume(Volume(values, (1.0, 1.0, 1.0))))) < 500_000


def tent() -> tuple[FloatArray, np.ndarray]:
    vertices = np.array([[0, 0, 0], [10, 0, 0], [10, 8, 0], [0, 8, 0], [5, 4, 6]], float)
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    return vertices, triangles


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-0.6, 0.8, 0.0)])
def test_plates_touch_the_body_and_arrows_push_it(axis: tuple[float, float, float]) -> None:
    vertices, triangles = tent()
    moved = vertices * [1.2, 0.5, 1.1]
    told = told_by(
        script(
            "body",
            body_viewer(
                [BodySurface("outline", "#ffffff", vertices, triangles)],
                [BodyScan("40 N", Pressed(axis, 40.0), [{"best": moved}], [{}])],
                [("best", "best")],
                "gap",
            ),
        )
    )
    (one,) = told["sets"]
    np.testing.assert_allclose(
        unpacked(one["surfaces"][0]["moved"]["best"]).reshape(-1, 3), moved, atol=0.01
    )
    way = np.asarray(axis)
    for stage, shape in (("rest", vertices), ("loaded", moved)):
        plates = [s["corners"] for s in one["stages"][stage]["sheets"] if s["kind"] == "plate"]
        heights = [np.asarray(corners) @ way for corners in plates]
        along = shape @ way
        np.testing.assert_allclose(heights[0], along.min(), atol=0.02)
        np.testing.assert_allclose(heights[1], along.max(), atol=0.02)
        (wall,) = [s["corners"] for s in one["stages"][stage]["sheets"] if s["kind"] == "wall"]
        np.testing.assert_allclose(np.asarray(wall)[:, 2], 0.0)
    assert one["stages"]["rest"]["arrows"] == []
    lower, upper = (
        np.subtract(a["to"], a["from"]) / np.linalg.norm(np.subtract(a["to"], a["from"]))
        for a in one["stages"]["loaded"]["arrows"]
    )
    np.testing.assert_allclose(lower, way, atol=0.01)
    np.testing.assert_allclose(upper, -way, atol=0.01)
    texts = [label["text"] for label in one["stages"]["loaded"]["labels"]]
    assert texts.count("40 N") == 2
