"""Voxel error of flat faces, measured on slabs at any position between voxels."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.comparison.observation.interface_residual import (
    InterfacePoints,
    observe,
    residual,
)
from palpate.workers.diagnosis.problem.inverse_problem import Scan
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES
from palpate.workers.diagnosis.problem.scan_noise import voxel_steps
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan

VOXEL_MM = 0.8
LENGTH_MM = 4.0
GRID = np.arange(-12.0, 13.0, 6.0)
NOTHING = cast(Any, None)


def face(slope: float, at_mm: float) -> tuple[Volume, np.ndarray, np.ndarray]:
    """Return a slab below a face through (0, 0, at_mm), points on the face and their normals."""
    n = 50
    centres = (np.arange(n) - n / 2 + 0.5) * VOXEL_MM
    z, _, x = np.meshgrid(centres, centres, centres, indexing="ij")
    inside = z < at_mm + slope * x
    values = np.where(inside, Tissue.FAT, Tissue.AIR).astype(np.uint8)
    values[: n // 4][inside[: n // 4]] = Tissue.GLANDULAR
    start = float(centres[0])
    px, py = (a.ravel() for a in np.meshgrid(GRID, GRID))
    points = np.column_stack([px, py, at_mm + slope * px])
    normals = np.tile(np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0), (len(points), 1))
    return Volume(values, (VOXEL_MM,) * 3, (start,) * 3), points, normals


def errors(slope: float, cases: int = 40) -> np.ndarray:
    """Return errors in the points' distances (cases, k), for faces anywhere between two layers."""
    found = []
    for at_mm in np.random.default_rng(1).uniform(0, VOXEL_MM, cases):
        labels, points, normals = face(slope, at_mm)
        found.append(residual(points, outline(points, normals), observe(labels, INTERFACES))[0])
    return np.array(found)


def said(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the covariance of points on one interface, (k, k)."""
    k = len(points)
    inverse = SimpleNamespace(
        points=outline(points, normals),
        bias=np.zeros(k),
        scans=[Scan("slab", NOTHING, NOTHING, voxel_mm=(VOXEL_MM,) * 3)],
        noise=SimpleNamespace(correlation_mm=LENGTH_MM),
    )
    columns = voxel_steps(cast(Any, inverse), [ComparedScan(points, np.zeros(k), normals)])
    return columns @ columns.T


def outline(points: np.ndarray, normals: np.ndarray) -> InterfacePoints:
    k = len(points)
    return InterfacePoints(
        points, normals, np.zeros(k, np.int32), np.ones(k), np.zeros(k, np.int32)
    )


def test_face_along_the_layers_has_a_common_voxel_error():
    found = errors(0.0)
    # All points of a face share one error, uniformly distributed over a voxel.
    assert found.std(axis=1).max() < 0.01
    assert found[:, 0].std() == pytest.approx(VOXEL_MM / np.sqrt(12), rel=0.2)
    covariance = said(*face(0.0, 0.3)[1:])
    np.testing.assert_allclose(covariance, VOXEL_MM**2 / 12, atol=0.003)


def test_face_across_the_layers_has_a_smaller_error():
    """Its mean error is smaller than along the layers, and within the modelled error."""
    slope = 0.02
    of_mean = errors(slope).mean(axis=1).std()
    allowed = np.sqrt(said(*face(slope, 0.3)[1:]).sum()) / len(GRID) ** 2
    along = VOXEL_MM / np.sqrt(12)
    assert of_mean < 0.5 * along
    assert of_mean < allowed < 0.75 * along


def test_a_steep_face_has_no_columns():
    """Its mean is off by 0.025 mm, within the nugget of a point."""
    assert errors(0.3).mean(axis=1).std() < 0.04
    assert np.abs(said(*face(0.3, 0.3)[1:])).max() == 0.0


def test_opposite_faces_have_independent_errors():
    _, points, normals = face(0.0, 0.3)
    k = len(points)
    covariance = said(np.vstack([points, points - 20.0]), np.vstack([normals, -normals]))
    assert np.abs(covariance[:k, k:]).max() == 0.0
    np.testing.assert_allclose(np.diag(covariance), VOXEL_MM**2 / 12, atol=0.003)
