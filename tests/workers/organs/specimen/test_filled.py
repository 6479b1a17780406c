"""Voxels of mesh files, compared with known volumes."""

import itertools

import meshio
import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.organs.specimen.block_lattice import lattice
from palpate.workers.organs.specimen.specimen_body import Body
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.organs.specimen.voxelised_mesh import filled
from tests.workers.organs.specimen.experiments import described, write

SIZE = (12.0, 10.0, 20.0)


def spec_of(folder, **body):
    data = described(body={"mesh": "a.vtk", "voxel_mm": 1.0} | body)
    if "labels" in body:
        soft = data["materials"]["rubber"]
        data["materials"] = {"soft": soft, "hard": soft}
    return read_spec(write(folder, data))


def ball(radius, count=40):
    """Return the points and triangles of a sphere around the origin."""
    theta = np.linspace(0, np.pi, count)[1:-1]
    phi = np.linspace(0, 2 * np.pi, 2 * count, endpoint=False)
    ring = [(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)) for t in theta for p in phi]
    points = radius * np.array([(0, 0, 1), (0, 0, -1), *ring])
    n, faces = len(phi), []
    for j in range(n):
        faces.append((0, 2 + j, 2 + (j + 1) % n))
        last = 2 + (len(theta) - 1) * n
        faces.append((1, last + (j + 1) % n, last + j))
    for i, j in itertools.product(range(len(theta) - 1), range(n)):
        a, b = 2 + i * n + j, 2 + i * n + (j + 1) % n
        faces += [(a, a + n, b), (b, a + n, b + n)]
    return points, np.array(faces)


def test_fills_a_sphere_of_triangles(tmp_path):
    points, faces = ball(10.0)
    meshio.write(tmp_path / "a.stl", meshio.Mesh(points, [("triangle", faces)]))
    volume = filled(spec_of(tmp_path, mesh="a.stl", voxel_mm=0.5), tmp_path / "a.stl")
    z, y, x = np.nonzero(volume.values)
    assert len(x) * volume.voxel_mm3 == pytest.approx(4 / 3 * np.pi * 10**3, rel=0.01)
    centre = np.array([x.mean(), y.mean(), z.mean()]) * 0.5 + volume.origin_mm
    np.testing.assert_allclose(centre, 0, atol=0.01)


def test_fills_the_surface_of_a_block_in_metres(tmp_path):
    mesh = lattice(SIZE, (3, 3, 5))
    faces = boundary_triangles(mesh.tets)
    meshio.write(tmp_path / "a.stl", meshio.Mesh(mesh.nodes / 1000, [("triangle", faces)]))
    spec = spec_of(tmp_path, mesh="a.stl", voxel_mm=0.5, mm_per_unit=1000)
    volume = filled(spec, tmp_path / "a.stl")
    assert volume.values.all()
    assert volume.values.size * volume.voxel_mm3 == pytest.approx(np.prod(SIZE))
    body = Body(spec, volume)
    np.testing.assert_allclose(body.box_mm[1], SIZE, atol=1e-4)  # STL keeps single precision
    assert body.wall_mm == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose(body.base_mm, (6, 5, 0), atol=1e-3)


def test_rejects_an_open_surface(tmp_path):
    points, faces = ball(10.0)
    open_one = faces[points[faces][:, :, 2].mean(axis=1) < 5]
    meshio.write(tmp_path / "a.stl", meshio.Mesh(points, [("triangle", open_one)]))
    with pytest.raises(InputError, match="not a closed surface"):
        filled(spec_of(tmp_path, mesh="a.stl", voxel_mm=0.5), tmp_path / "a.stl")


def test_tetrahedra_keep_their_labels(tmp_path):
    mesh = lattice(SIZE, (3, 3, 6))
    labels = np.where(mesh.nodes[mesh.tets][:, :, 2].max(axis=1) <= 10.01, 7, 9)
    solid = meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)], cell_data={"kind": [labels]})
    meshio.write(tmp_path / "a.vtk", solid)
    spec = spec_of(tmp_path, labels={7: "soft", 9: "hard"})
    values = filled(spec, tmp_path / "a.vtk").values
    assert (values > 0).all()
    assert (values[:6] == Tissue.FAT).all()
    assert (values[-8:] == Tissue.GLANDULAR).all()
    with pytest.raises(InputError, match=r"labels \[9\]"):
        filled(spec_of(tmp_path, labels={7: "soft"}), tmp_path / "a.vtk")
    with pytest.raises(InputError, match="the file has kind"):
        filled(spec_of(tmp_path, labels={7: "soft"}, label_array="k"), tmp_path / "a.vtk")


def test_rejects_damaged_and_tiny_meshes(tmp_path):
    (tmp_path / "a.vtk").write_text("words")
    with pytest.raises(InputError, match="mesh"):
        filled(spec_of(tmp_path), tmp_path / "a.vtk")
    points, faces = ball(3.0)
    meshio.write(tmp_path / "b.stl", meshio.Mesh(points, [("triangle", faces)]))
    with pytest.raises(InputError, match="too large"):
        filled(spec_of(tmp_path, mesh="b.stl"), tmp_path / "b.stl")
