"""Adaptive meshes of phantoms: shape, labels, volumes, neighbours, repeatability."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import TetMesh, Tissue, Volume
from palpate.workers.body.mesh.adaptive_lattice import Sizes
from palpate.workers.body.mesh.adaptive_mesher import AdaptiveMesh, adaptive_mesh
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles, measures, triangle_areas_mm2
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.thesis.mesh_quality import agreement

SMALL = BreastPhantom(
    lower_mm=18.75, upper_mm=20.0, half_width_mm=18.75, depth_mm=18.75, compartments=20,
    spacing_mm=0.3, glandular_fraction=0.2,
)  # fmt: skip


@pytest.fixture(scope="module")
def labels() -> Volume:
    return generate_breast(SMALL, 3).labels


@pytest.fixture(scope="module")
def meshed(labels: Volume) -> AdaptiveMesh:
    return adaptive_mesh(labels, Sizes(0.8))


def test_quality_matches_the_adaptive_meshes_of_the_thesis(meshed: AdaptiveMesh) -> None:
    found = measures(meshed.mesh)
    assert found["volume_mm3"].min() > 0
    # Thesis Table 4.2, with 1 for a regular tetrahedron.
    assert found["aspect"].mean() <= 1.70
    assert found["aspect"].max() <= 8.86


def test_keeps_labels_and_volumes(meshed: AdaptiveMesh, labels: Volume) -> None:
    found = agreement(meshed.mesh, meshed.inside, labels)
    assert found.labels >= 0.985
    assert abs(found.tissue_volume) < 0.01
    assert abs(found.body_volume) < 0.002


def test_has_no_hanging_node_and_no_hole(meshed: AdaptiveMesh) -> None:
    """The boundary is one closed surface that encloses the volume of the tetrahedra."""
    mesh = meshed.mesh
    triangles = boundary_triangles(mesh.tets)
    edges = np.sort(triangles[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()
    x = mesh.nodes[triangles]
    enclosed = np.einsum("ki,ki->k", x[:, 0], np.cross(x[:, 1], x[:, 2])).sum() / 6
    volume = measures(mesh)["volume_mm3"].sum()
    assert enclosed == pytest.approx(volume)
    on_wall = np.zeros(len(mesh.nodes), np.bool_)
    on_wall[meshed.wall] = True
    flat = triangles[on_wall[triangles].all(axis=1)]
    outline = np.pi / 4 * 37.5 * (SMALL.lower_mm + SMALL.upper_mm)
    assert triangle_areas_mm2(mesh.nodes, flat).sum() == pytest.approx(outline, rel=0.02)
    assert len(np.unique(mesh.tets)) == len(mesh.nodes)


def test_cells_are_small_at_the_surface_and_large_elsewhere(meshed: AdaptiveMesh) -> None:
    volumes = measures(meshed.mesh)["volume_mm3"]
    tets = meshed.mesh.tets
    shared = np.intersect1d(tets[meshed.inside], tets[~meshed.inside])
    touching = np.isin(tets, shared).any(axis=1)
    lattice = 0.8**3 / 12
    assert np.median(volumes[touching]) == pytest.approx(lattice, rel=0.5)
    assert volumes.max() > 8 * lattice


def test_equal_input_gives_equal_output(meshed: AdaptiveMesh, labels: Volume) -> None:
    again = adaptive_mesh(labels, Sizes(0.8))
    assert np.array_equal(again.mesh.nodes, meshed.mesh.nodes)
    assert np.array_equal(again.mesh.tets, meshed.mesh.tets)
    assert np.array_equal(again.inside, meshed.inside)


def test_agreement_matches_the_counts_of_a_known_mesh() -> None:
    """A cube of six tetrahedra, one of them inside, against sampled voxels."""
    values = np.full((12, 12, 12), Tissue.FAT, np.uint8)
    z, y, x = np.mgrid[:12, :12, :12]
    values[(z < y) & (y < x)] = Tissue.GLANDULAR
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)]) * 12.0 - 0.5
    kuhn = np.array(
        [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
    )
    mesh = TetMesh(corners + 1e-6, kuhn.astype(np.int32))
    labels = Volume(values, (1.0, 1.0, 1.0))
    first = np.arange(6) == 0  # x > y > z
    found = agreement(mesh, first, labels)
    on_faces = ((x == y) | (y == z)) & (z <= y) & (y <= x)
    assert found.labels >= 1 - on_faces.mean() - 1e-9
    assert found.body_volume == pytest.approx(0.0, abs=1e-9)
    assert found.tissue_volume == pytest.approx(12**3 / 6 / 220 - 1)
    wrong = agreement(mesh, ~first, labels)
    assert wrong.labels < 0.2


def test_refuses_invalid_sizes_and_labels(labels: Volume) -> None:
    with pytest.raises(InputError, match="0 < smallest"):
        Sizes(0.0)
    with pytest.raises(InputError, match="0 < smallest"):
        Sizes(1.0, skin_mm=0.5)
    with pytest.raises(InputError, match="No voxel is muscle"):
        adaptive_mesh(labels, Sizes(1.0), Tissue.MUSCLE)
