"""Coarse surfaces are closed, oriented outwards, and as large as the originals."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.diagnosis.problem.prepared_parts import shape

RADIUS_MM = 20.0


@pytest.fixture(scope="module")
def ball():
    z, y, x = np.mgrid[-24:25, -24:25, -24:25]
    inside = x**2 + y**2 + z**2 < RADIUS_MM**2
    return Volume(inside.astype(np.uint8), (1.0, 1.0, 1.0), (-24.0, -24.0, -24.0))


def volume_of(drawn):
    """Return the volume by Gauss' theorem; it is positive only if triangles face outwards."""
    a, b, c = (drawn.vertices[drawn.triangles[:, i]] for i in range(3))
    return float((np.cross(b - a, c - a) * a).sum() / 6)


def test_a_coarse_ball_is_nearly_as_large_with_far_fewer_triangles(ball):
    true = 4 / 3 * np.pi * RADIUS_MM**3
    errors, counts = [], []
    for edge_mm in (6.0, 3.0, 1.5):
        drawn = shape(ball, (Tissue.FAT,), edge_mm)
        errors.append(abs(volume_of(drawn) / true - 1))
        counts.append(len(drawn.triangles))
    # A chord is inside its arc by a distance proportional to its squared length.
    assert errors[2] < errors[1] < errors[0] < 0.08
    assert errors[1] < 0.03
    assert counts[0] < 500
    assert counts[0] < counts[1] / 3 < counts[2] / 9


def test_coarse_surfaces_are_closed(ball):
    drawn = shape(ball, (Tissue.FAT,))
    t = drawn.triangles
    edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    assert times.min() == 2


def test_triangles_face_outwards(ball):
    drawn = shape(ball, (Tissue.FAT,))
    a, b, c = (drawn.vertices[drawn.triangles[:, i]] for i in range(3))
    outwards = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1)
    assert (outwards > 0).all()


def test_rejects_invalid_values(ball):
    with pytest.raises(InputError, match="edge length of triangles must be > 0"):
        shape(ball, (Tissue.FAT,), 0.0)
    with pytest.raises(InputError, match="shorter edge"):
        shape(Volume(ball.values, ball.spacing_mm, (100.0, 100.0, 100.0)), (Tissue.FAT,), 500.0)
