"""Exported meshes are read by other programs with all their values."""

import meshio
import numpy as np
import pytest

from palpate.service.export.exported_mesh import MESH_FORMATS, export_mesh
from palpate.storage.errors import InputError, StoreError
from palpate.storage.values import TetMesh

NODES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1 / 3, 1 / 3, -0.7]])
MESH = TetMesh(NODES, np.array([[0, 1, 2, 3], [0, 2, 1, 4]], np.int32))
DISPLACEMENT = np.random.default_rng(0).normal(size=(5, 3))


@pytest.mark.parametrize("suffix", MESH_FORMATS)
def test_nodes_tetrahedra_and_values_round_trip(tmp_path, suffix):
    path = tmp_path / f"body{suffix}"
    tissue = np.array([1, 2], np.uint8)
    points = {"displacement_mm": DISPLACEMENT, "wall": np.array([1, 1, 0, 0, 0], bool)}
    export_mesh(path, MESH, points, {"tissue": tissue, "energy_mj": np.array([0.5, 1 / 3])})

    read = meshio.read(path)
    assert np.array_equal(read.points, NODES)
    assert np.array_equal(read.cells_dict["tetra"], MESH.tets)
    assert np.array_equal(read.point_data["displacement_mm"], DISPLACEMENT)
    assert np.array_equal(read.point_data["wall"].ravel(), [1, 1, 0, 0, 0])
    assert np.array_equal(read.cell_data["tissue"][0].ravel(), [1, 2])
    assert np.array_equal(read.cell_data["energy_mj"][0].ravel(), [0.5, 1 / 3])
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_older_file_is_replaced(tmp_path):
    path = tmp_path / "body.vtu"
    path.write_text("old")
    export_mesh(path, MESH)
    assert len(meshio.read(path).points) == 5


@pytest.mark.parametrize("name", ["body.xyz", "body", "body.stl"])
def test_unknown_format_lists_supported_ones(tmp_path, name):
    with pytest.raises(InputError, match=r"Use one of \.vtu, \.vtk, \.msh"):
        export_mesh(tmp_path / name, MESH)


def test_values_must_fit_the_mesh(tmp_path):
    with pytest.raises(InputError, match=r"'u' has shape \(4, 3\).*5 nodes"):
        export_mesh(tmp_path / "b.vtu", MESH, {"u": DISPLACEMENT[:4]})
    with pytest.raises(InputError, match=r"'t' has shape \(5,\).*2 tetrahedra"):
        export_mesh(tmp_path / "b.vtu", MESH, None, {"t": np.zeros(5)})
    assert list(tmp_path.iterdir()) == []


def test_missing_folder_raises_store_error(tmp_path):
    with pytest.raises(StoreError, match="Cannot write"):
        export_mesh(tmp_path / "nowhere" / "b.vtu", MESH)
