"""Exported files against the solved body."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as Xml

import meshio
import numpy as np
import pytest

from palpate.service.cli import main
from palpate.service.export.export_formats import export_solved
from palpate.service.export.solved_mesh_files import SolvedBody, solve_body
from palpate.service.export.solver_model import SolverModel, comparable, contact_nodes, solver_model
from palpate.storage.errors import InputError
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.mechanics.fem.external_forces import stated_springs
from tests.service.export.small_breast import CASE, CONSTANTS


def test_mesh_file_has_stress_and_strain(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.vtu"], body)
    found = meshio.read(tmp_path / "b.vtu")
    rest = found.points - found.point_data["displacement_mm"]
    np.testing.assert_allclose(rest, body.setup.model.finest.nodes, atol=1e-9)
    tets = found.cells_dict["tetra"]
    cells = {name: data[0] for name, data in found.cell_data.items()}

    def volume(x: np.ndarray) -> np.ndarray:
        return np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]])

    ratio = volume(found.points) / volume(rest)
    np.testing.assert_allclose(cells["volume_ratio"], ratio, rtol=1e-9)
    normal = cells["cauchy_stress_kpa"][:, :3]
    np.testing.assert_allclose(cells["pressure_kpa"], -normal.mean(axis=1), atol=1e-9)
    # The plate force, 60 N, acts on a middle plane: stress times area.
    force_n = 60 * np.ptp(found.points[:, 1]) * 1e3
    share = -(cells["cauchy_stress_kpa"][:, 1] * volume(found.points) / 6).sum()
    assert share == pytest.approx(force_n, rel=0.02)
    assert set(found.point_data) == {"displacement_mm", "volume_ratio", "pressure_kpa"}
    assert cells["green_strain"].shape == (len(tets), 6)


def test_surface_is_closed_and_encloses_the_volume(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.stl"], body)
    corners = np.frombuffer(
        (tmp_path / "b.stl").read_bytes()[84:],
        np.dtype([("normal", "<f4", 3), ("x", "<f4", (3, 3)), ("spare", "<u2")]),
    )["x"].astype(float)
    ml = np.linalg.det(corners).sum() / 6e3
    elements = body.level.model.elements
    assert ml == pytest.approx((elements.volumes * body.fields.volume_ratio).sum() / 1e3, rel=1e-5)
    a, b, c = np.moveaxis(corners, 1, 0)
    assert np.abs(np.cross(b - a, c - a).sum(axis=0)).max() < 1e-3 * ml * 1e3


def test_labels_match_the_deformed_body(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.nrrd"], body)
    labels = read_volume_file(tmp_path / "b.nrrd")
    ml = (labels.values > 0).sum() * labels.voxel_mm3 / 1e3
    assert ml == pytest.approx(
        (body.level.model.elements.volumes * body.fields.volume_ratio).sum() / 1e3, rel=0.03
    )


@pytest.fixture(scope="module")
def told(body: SolvedBody) -> SolvedBody:
    return body.under(comparable(body.solved.problem))


@pytest.fixture(scope="module")
def model(body: SolvedBody, told: SolvedBody) -> SolverModel:
    return solver_model(body, told)


def test_febio_file_matches_the_model(body: SolvedBody, model: SolverModel, tmp_path: Path) -> None:
    """Structure and syntax match a file solved by FEBio 4.11."""
    export_solved([tmp_path / "b.feb"], body)
    root = Xml.parse(tmp_path / "b.feb").getroot()
    assert [part.tag for part in root] == [
        "Module",
        "Control",
        "Material",
        "Mesh",
        "MeshDomains",
        "MeshData",
        "Boundary",
        "LoadData",
        "Output",
    ]
    nodes = np.array(
        [[float(v) for v in n.text.split(",")] for n in root.iter("node") if "id" in n.attrib]
    )
    np.testing.assert_allclose(nodes, model.nodes, rtol=1e-9, atol=1e-9)
    domains = {d.get("name"): d.get("mat") for d in root.iter("SolidDomain")}
    materials = {m.get("name") for m in root.iter("material")}
    assert set(domains) == set(domains.values()) == materials
    counts = {e.get("name"): len(e) for e in root.iter("Elements")}
    assert counts["FAT"] + counts["GLANDULAR"] == len(model.tets)
    assert 0 < counts["FIBRES1_FAT"] < counts["FAT"]  # only stretched elements
    sets = {s.get("name"): [int(n) - 1 for n in s.text.split(",")] for s in root.iter("NodeSet")}
    data = {d.get("node_set"): [float(n.text) for n in d] for d in root.iter("NodeData")}
    for condition in root.iter("bc"):
        where, axis = condition.get("node_set"), "xyz".index(condition.find("dof").text)
        expected = np.flatnonzero(model.prescribed[:, axis])
        # Only our springs hold the body along x: one node replaces them.
        assert len(sets[where]) == 1 if axis == 0 else list(sets[where]) == expected.tolist()
        np.testing.assert_allclose(
            data[where], model.displacement_mm[sets[where], axis], rtol=1e-9, atol=1e-12
        )
    fibre = next(m for m in root.iter("material") if m.get("type") == "fiber-exp-pow")
    assert float(fibre.find("ksi").text) == pytest.approx(0.05)
    assert fibre.find("fiber").text == "0,0,1"


def test_plates_prescribe_only_the_normal_component(told: SolvedBody, model: SolverModel) -> None:
    touching = contact_nodes(told)
    assert touching.sum() > 20
    np.testing.assert_array_equal(model.prescribed[:, 1], touching)
    assert not model.prescribed[:, 0].any()


def test_deck_header_lists_omissions(body: SolvedBody, tmp_path: Path) -> None:
    export_solved([tmp_path / "b.inp"], body)
    header = " ".join(re.findall(r"^\*\* (.*)$", (tmp_path / "b.inp").read_text(), re.MULTILINE))
    assert "a small breast" in header
    assert "textbook linear tetrahedra" in header
    assert "Plates: replaced by the displacements" in header
    assert re.search(r"moves the nodes by 0\.\d+ mm \(mean", header)
    assert "E_fat = 0.01" in header


def test_header_names_omitted_features(store: str, tmp_path: Path) -> None:
    constants = CONSTANTS | {"E_skin": 0.1}
    found = solve_body(CASE | {"model": {"skin": "membrane"}}, constants, store, "with skin")
    export_solved([tmp_path / "b.inp"], found)
    header = (tmp_path / "b.inp").read_text().partition("*NODE")[0]
    assert "Skin: left out" in header


def test_rejects_laws_that_other_solvers_lack(store: str, tmp_path: Path) -> None:
    model = {"model": {"law": {"fat": "fung"}}}
    found = solve_body(CASE | model, CONSTANTS | {"fung_b_fat": 2.0}, store, "another law")
    with pytest.raises(InputError, match=r"other laws \(fat: Fung, .*\.vtu"):
        export_solved([tmp_path / "b.feb"], found)
    assert not (tmp_path / "b.feb").exists()
    export_solved([tmp_path / "b.vtu"], found)


def test_attachments_become_springs_and_growth_is_omitted(store: str, tmp_path: Path) -> None:
    hidden = {"attachment_stiffness_x": 1e-4, "attachment_z": -20.0, "ln_growth_fat": 0.02}
    own = solve_body(CASE, CONSTANTS | hidden, store, "a body that is held")
    found = solver_model(own, own.under(comparable(own.solved.problem)))
    problem, level = own.solved.problem, own.level
    without = stated_springs(level.model, replace(problem, attachments=()))
    patch = found.stated_springs_n_per_mm - without
    (attachment,) = problem.attachments
    face = level.model.wall_areas[level.model.wall]
    on_wall = face * attachment.weight(level.model.nodes[level.model.wall]) * 1e-4
    assert patch[level.model.wall, 0].sum() >= on_wall.sum() > 0.01
    assert not patch[:, 1:].any()
    np.testing.assert_allclose(found.stated_springs_n_per_mm + found.drift_n_per_mm, level.springs)
    assert "Growth: left out." in found.remarks
    # FEBio gets the middle of the patch, 3.7 radii wide, and no distant skin.
    export_solved([tmp_path / "b.feb"], own)
    root = Xml.parse(tmp_path / "b.feb").getroot()
    sets = {s.get("name"): [int(n) - 1 for n in s.text.split(",")] for s in root.iter("NodeSet")}
    along = {c.find("dof").text: sets[c.get("node_set")] for c in root.iter("bc")}
    nodes = level.model.nodes[along["x"]]
    away = np.linalg.norm(nodes - attachment.centre_mm, axis=1) / attachment.radius_mm
    assert 1 < len(nodes) < np.count_nonzero(patch[:, 0])
    assert away.max() < 4.2


@pytest.mark.slow
def test_rejects_a_diverged_body(store: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="diverged"):
        solve_body(CASE | {"load": {"force_n": 1e6}}, CONSTANTS, store, "crushed")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["export", "s.yaml", "b.obj"], "b.obj: .obj is not supported; use one of .feb"),
        (["export", "s.yaml", "no/b.vtu"], "does not exist; create it"),
        (["export", "s.yaml", "b.inp", "--candidate", "best"], "needs the folder of a study"),
        (
            ["export", "s.yaml", "b.inp", "--candidate", "1", "--set", "nu=0.4"],
            "cannot be combined",
        ),
        (["export", "nix.yaml", "b.inp"], "nix.yaml"),
    ],
)
def test_invalid_arguments_fail_before_solving(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from tests.recovery.stand_ins import SPEC

    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SPEC)
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("Error: ") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s.yaml"]
