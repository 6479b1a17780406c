"""A plane section of a box of tetrahedra is a rectangle, tiled by polygons."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from palpate.storage.values import FloatArray, TetMesh
from palpate.workers.thesis.mesh_quality import plane_section

SIZE_MM = np.array([2.0, 3.0, 5.0])


@pytest.fixture(scope="module")
def box() -> TetMesh:
    rng = np.random.default_rng(4)
    corners = np.array(np.meshgrid(*[[0, 1]] * 3)).reshape(3, -1).T
    nodes = np.concatenate([corners, rng.random((60, 3))]) * SIZE_MM
    tets = Delaunay(nodes).simplices.astype(np.int32)
    return TetMesh(nodes, tets)


def area_of(polygons: FloatArray) -> FloatArray:
    """Return the area of each polygon by the shoelace formula; too small if sides cross."""
    x, y = polygons[..., 0], polygons[..., 1]
    return 0.5 * np.abs((x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1))


@pytest.mark.parametrize("normal", [0, 1, 2])
@pytest.mark.parametrize("part", [0.03, 0.5, 0.77])
def test_polygons_tile_the_rectangle(box: TetMesh, normal: int, part: float) -> None:
    found = plane_section(box, normal, part * SIZE_MM[normal])
    across = np.delete(SIZE_MM, normal)
    assert area_of(found.polygons).sum() == pytest.approx(across.prod(), rel=1e-12)
    assert found.polygons.min() > -1e-12
    assert (found.polygons.max(axis=(0, 1)) < across + 1e-12).all()


def test_each_polygon_is_in_its_tetrahedron(box: TetMesh) -> None:
    found = plane_section(box, 2, 2.0)
    corners = box.nodes[box.tets[found.tets]]
    places = np.insert(found.polygons.mean(axis=1), 2, 2.0, axis=1)
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    at = np.linalg.solve(edges, (places - corners[:, 0])[..., None])[..., 0]
    assert at.min() > -1e-9
    assert at.sum(axis=1).max() < 1 + 1e-9


def test_handles_plane_through_nodes_and_plane_outside_the_body(box: TetMesh) -> None:
    within = box.nodes[8:, 2]
    found = plane_section(box, 2, float(within[0]))
    assert area_of(found.polygons).sum() == pytest.approx(6.0, rel=1e-6)
    assert len(plane_section(box, 2, 5.5).polygons) == 0
