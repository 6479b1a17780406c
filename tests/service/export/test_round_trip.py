"""Round trips: every format listed by `palpate export --help` is written and read."""

import re
from pathlib import Path
from xml.etree import ElementTree as Xml

import meshio
import numpy as np
import pytest
from PIL import Image

from palpate.service.cli import main
from palpate.service.export.export_formats import export_solved
from palpate.service.export.solved_mesh_files import SolvedBody
from palpate.service.export.solver_model import SolverModel, comparable, solver_model
from palpate.service.export.stored_files import (
    MESH_SUFFIXES,
    TISSUE_NAMES,
    VOLUME_SUFFIXES,
    export_volume,
    solved_suffixes,
)
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.image_formats import read_labels
from palpate.workers.body.images.named_labels import read_tissues
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles

LABEL_SUFFIXES = (*VOLUME_SUFFIXES, ".seg.nrrd")
SOLVER_SUFFIXES = (".inp", ".feb")


def test_help_lists_exactly_the_supported_suffixes(capsys: pytest.CaptureFixture[str]) -> None:
    tested = {*MESH_SUFFIXES, *LABEL_SUFFIXES, *SOLVER_SUFFIXES, ".stl", ".pvd", ".gif"}
    assert main(["export", "--help"]) == 0
    listed = set(re.findall(r"(?<![\w.])\.[a-z]{3,4}(?:\.[a-z]+)?\b", capsys.readouterr().out))
    assert listed == tested
    assert set(solved_suffixes()) == tested - {".seg.nrrd"}


def full(six: np.ndarray) -> np.ndarray:
    """Return symmetric tensors from xx, yy, zz, xy, yz, xz, row by row."""
    return six[:, [0, 3, 5, 3, 1, 4, 5, 4, 2]]


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_mesh_round_trips_with_fields(body: SolvedBody, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"b{suffix}"
    export_solved([path], body)
    found = meshio.read(path)
    np.testing.assert_allclose(found.points, body.positions_mm, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.cells_dict["tetra"], body.level.model.elements.tets)
    points = {
        "displacement_mm": body.displacement_mm,
        "volume_ratio": body.fields.node_volume_ratio,
        "pressure_kpa": 1e3 * body.fields.node_pressure_mpa,
    }
    cells = {
        "tissue": body.level.model.fractions.argmax(axis=1),
        "volume_ratio": body.fields.volume_ratio,
        "pressure_kpa": 1e3 * body.fields.pressure_mpa,
        "von_mises_kpa": 1e3 * body.fields.von_mises_mpa,
    }
    for name, values in points.items():
        np.testing.assert_allclose(found.point_data[name], values, atol=1e-12)
    for name, values in cells.items():
        np.testing.assert_allclose(found.cell_data[name][0].ravel(), values, atol=1e-12)
    tensors = {
        "cauchy_stress_kpa": 1e3 * body.fields.cauchy_mpa,
        "green_strain": body.fields.green_strain,
    }
    for name, values in tensors.items():
        read = found.cell_data[name][0]
        nine = read if suffix == ".msh" else full(read)
        np.testing.assert_allclose(nine, values.reshape(-1, 9), atol=1e-9)
    known = {*points, *cells, *tensors}
    extra = {*found.point_data, *found.cell_data} - known
    assert all(name.startswith("gmsh:") for name in extra)


def test_surface_round_trips(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.stl"], body)
    found = meshio.read(tmp_path / "b.stl")
    triangles = boundary_triangles(body.level.model.elements.tets)
    corners = found.points[found.cells_dict["triangle"]]
    np.testing.assert_allclose(corners, body.positions_mm[triangles], atol=1e-4)


@pytest.mark.parametrize("suffix", LABEL_SUFFIXES)
def test_labels_round_trip_by_name(body: SolvedBody, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"b{suffix}"
    export_solved([path], body)
    written, found = body.deformed_labels(), read_labels(path)
    np.testing.assert_array_equal(found.volume.values, written.values)
    np.testing.assert_allclose(found.volume.spacing_mm, written.spacing_mm, rtol=1e-6)
    np.testing.assert_allclose(found.volume.origin_mm, written.origin_mm, atol=1e-4)
    present = np.unique(written.values)
    assert found.names == {k: name for k, name in TISSUE_NAMES.items() if k in present}
    assert found.anatomical
    tissues = read_tissues(path).tissues
    assert all(tissues[int(k)] == Tissue(int(k)) for k in present if k)


@pytest.mark.parametrize("suffix", LABEL_SUFFIXES)
def test_labels_are_matched_by_name_not_number(suffix: str, tmp_path: Path) -> None:
    """Labels of another program, a name with characters escaped in XML, an unknown position."""
    values = np.zeros((3, 4, 5), np.int64)
    values[1, 1:3, 1:4], values[1, 1, 1] = 300, 7
    names = {300: "Fat", 7: "Glandular <left & right>"}
    volume = Volume(values, (0.5, 0.75, 2.0), (-3.0, 4.0, 7.5), place_known=False)
    path = tmp_path / f"b{suffix}"
    export_volume(path, volume, names)
    found = read_labels(path)
    np.testing.assert_array_equal(found.volume.values, values)
    assert found.names == names
    assert found.volume.spacing_mm == volume.spacing_mm
    assert not found.volume.place_known


@pytest.fixture(scope="module")
def model(body: SolvedBody) -> SolverModel:
    return solver_model(body, body.under(comparable(body.solved.problem)))


def test_calculix_file_round_trips(body: SolvedBody, model: SolverModel, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.inp"], body)
    nodes, tets, reading = [], [], ""
    for line in (tmp_path / "b.inp").read_text().splitlines():
        if line.startswith("*"):
            reading = line
        elif reading.startswith("*NODE") and "PRINT" not in reading and "FILE" not in reading:
            nodes.append([float(v) for v in line.split(",")[1:]])
        elif reading.startswith("*ELEMENT") and "C3D4" in reading:
            tets.append(tuple(int(v) - 1 for v in line.split(",")[1:]))
    np.testing.assert_allclose(nodes, model.nodes, rtol=1e-8, atol=1e-8)
    assert {*tets} == {*map(tuple, model.tets)}


def test_febio_file_round_trips(body: SolvedBody, model: SolverModel, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.feb"], body)
    mesh = Xml.parse(tmp_path / "b.feb").getroot().find("Mesh")
    nodes = [[float(v) for v in n.text.split(",")] for n in mesh.iter("node") if n.get("id")]
    np.testing.assert_allclose(nodes, model.nodes, rtol=1e-8, atol=1e-8)
    elements = [tuple(int(v) - 1 for v in e.text.split(",")) for e in mesh.iter("elem")]
    assert {*elements} == {*map(tuple, model.tets)}


def test_series_goes_from_rest_to_load(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.pvd"], body)
    told = (tmp_path / "b.pvd").read_text()
    assert "scaled from 0 to 1, not load steps" in told
    steps = list(Xml.fromstring(told).iter("DataSet"))
    assert [float(s.get("timestep")) for s in steps] == pytest.approx(np.linspace(0, 1, 11))
    rest = body.positions_mm - body.displacement_mm
    for step in steps:
        found = meshio.read(tmp_path / step.get("file"))
        moved = float(step.get("timestep")) * body.displacement_mm
        np.testing.assert_allclose(found.point_data["displacement_mm"], moved, atol=1e-12)
        np.testing.assert_allclose(found.points, rest + moved, atol=1e-12)
        np.testing.assert_array_equal(found.cells_dict["tetra"], body.level.model.elements.tets)


def test_movie_is_animated(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.gif"], body)
    with Image.open(tmp_path / "b.gif") as movie:
        assert movie.is_animated
        first = np.asarray(movie.convert("RGB"), float)
        movie.seek(movie.n_frames - 1)
        last = np.asarray(movie.convert("RGB"), float)
    assert first.shape == (440, 560, 3)
    assert (np.abs(first - last).max(axis=2) > 60).mean() > 0.05
