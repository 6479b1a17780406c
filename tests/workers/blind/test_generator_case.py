"""A complete case as files, read as the diagnosis reads it."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml

from palpate.storage.values import Tissue, Volume
from palpate.workers.blind.case_body import (
    Segmenter,
    body_of,
    deformed_labels,
    glandular_share,
    locate,
    padded,
    points_on,
    segmented,
)
from palpate.workers.blind.case_deviations import Deviations
from palpate.workers.blind.case_files import write_case
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.setup_causes import ImageScale
from palpate.workers.blind.solver.quadratic_mesh import fine_mesh_of
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    signed_distance,
)
from palpate.workers.comparison.observation.segmentation_noise import noise_from_repeat

COARSE = {"corners": 700, "spacing_mm": 1.2}
FILES = ["case.yaml", "deformed_y1.nrrd", "deformed_y2.nrrd", "reference.nrrd"]


@cache
def made(folder, seed, kind):
    truth = draw(seed, kind, one_direction=True)
    case, hidden = folder / f"{kind}-case", folder / f"{kind}-truth"
    write_case(truth, case, hidden, **COARSE)
    return case, hidden


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("blind")


@pytest.fixture(scope="module")
def body():
    return body_of(draw(3).anatomy, 800, 0.8)


@pytest.mark.slow
def test_true_points_are_on_the_interfaces_in_the_scans(folder):
    case, hidden = made(folder, 4, "tilt")
    truth = np.load(hidden / "truth.npz")
    noise = json.loads((hidden / "truth.json").read_text())["noise_sd_mm"]
    scans = ["reference.nrrd", "deformed_y1.nrrd", "deformed_y2.nrrd"]
    moves = [np.zeros_like(truth["points"]), *truth["displacement"]]
    for name, move in zip(scans, moves, strict=True):
        labels = read_volume_file(case / name)
        for number, interface in enumerate((OUTLINE, GLANDULAR)):
            mine = truth["interface"] == number
            away, _ = signed_distance(labels, interface.inside).at((truth["points"] + move)[mine])
            # At thin strands, the nearest boundary may be a different one.
            near = away[np.abs(away) < 4 * noise]
            assert len(near) > 0.9 * len(away)
            assert abs(np.median(near)) < 0.08
            assert 0.75 * noise < near.std() < 1.4 * noise


@pytest.mark.slow
def test_hard_world_scan_has_its_drawn_pose(folder):
    """The second scan is shifted by two millimetres along y, with no other cause."""
    pose = (0.0, 2.0, 0.0, 0.0, 0.0, 0.0)
    off = Deviations(noise_factor=0.5, poses=((0.0,) * 6, pose))
    truth = replace(draw(4, "control", one_direction=True), deviations=off)
    case, hidden = folder / "posed-case", folder / "posed-truth"
    write_case(truth, case, hidden, **COARSE)
    there, moves = np.load(hidden / "truth.npz"), [0.0, 2.0]
    mine = there["interface"] == 0
    for name, displacement, shift in zip(FILES[1:3], there["displacement"], moves, strict=True):
        outline = signed_distance(read_volume_file(case / name), OUTLINE.inside)
        away, _ = outline.at((there["points"] + displacement)[mine] + [0.0, shift, 0.0])
        assert abs(np.median(away)) < 0.08
        assert away.std() < 0.75 * truth.noise_sd_mm
    stated = yaml.safe_load((case / "case.yaml").read_text())["noise"]
    assert stated["sd_mm"] == truth.noise_sd_mm


@pytest.mark.slow
def test_image_scale_enlarges_the_body_in_its_scan(folder):
    """The body grows by 2 % along y about its middle at rest: 0.9 mm at a flank of 45 mm."""
    truth = draw(4, "control", one_direction=True)
    scale = ImageScale((0.0, 0.02, 0.0), truth.anatomy.centre_mm)
    truth = replace(truth, causes=(scale,))
    case, hidden = folder / "scaled-case", folder / "scaled-truth"
    write_case(truth, case, hidden, **COARSE)
    there = np.load(hidden / "truth.npz")
    mine = there["interface"] == 0
    for name, displacement in zip(FILES[1:3], there["displacement"], strict=True):
        went = (there["points"] + displacement)[mine]
        outline = signed_distance(read_volume_file(case / name), OUTLINE.inside)
        away, _ = outline.at(went * [1.0, 1.02, 1.0])
        assert abs(np.median(away)) < 0.08
        assert away.std() < 1.4 * truth.noise_sd_mm
        flank = np.abs(went[:, 1]) > 0.8 * np.abs(went[:, 1]).max()
        unscaled, _ = outline.at(went[flank])
        assert np.median(np.abs(unscaled)) > 0.4


def test_larger_loads_move_the_body_further_and_all_exceed_noise(folder):
    _, hidden = made(folder, 4, "tilt")
    truth = np.load(hidden / "truth.npz")
    low, high = np.linalg.norm(truth["displacement"], axis=2).mean(axis=1)
    assert 2 < low < high < 25
    record = json.loads((hidden / "truth.json").read_text())
    width = 2 * record["anatomy"]["half_width_mm"]
    shares = np.array(record["plate_travel_mm"]) / width
    assert 0.1 < shares[0] < shares[1] < 0.32


@pytest.mark.slow
def test_control_and_case_differ_only_in_their_scans(folder):
    cases = [made(folder, 4, kind)[0] for kind in ("tilt", "control")]
    for case in cases:
        assert sorted(p.name for p in case.iterdir()) == FILES
        assert len({p.stat().st_mtime for p in case.iterdir()}) == 1
    words = [yaml.safe_load((c / "case.yaml").read_text()) for c in cases]
    assert words[0].pop("name") == "tilt-case"
    assert words[1].pop("name") == "control-case"
    assert words[0] == words[1]
    assert list(words[0]) == list(words[1])
    scans = [read_volume_file(c / "reference.nrrd").values for c in cases]
    assert np.array_equal(*scans)
    deformed = [(c / "deformed_y2.nrrd").read_bytes() for c in cases]
    assert deformed[0] != deformed[1]


@pytest.mark.slow
def test_same_truth_writes_same_bytes(folder, tmp_path):
    case, hidden = made(folder, 4, "control")
    truth = draw(4, "control", one_direction=True)
    write_case(truth, tmp_path / "control-case", tmp_path / "truth", **COARSE)
    for first, second in ((case, tmp_path / "control-case"), (hidden, tmp_path / "truth")):
        for path in first.iterdir():
            assert path.read_bytes() == (second / path.name).read_bytes(), path.name


def test_case_names_loads_axes_and_plates(folder):
    case, _ = made(folder, 4, "control")
    words = yaml.safe_load((case / "case.yaml").read_text())
    truth = draw(4, "control", one_direction=True)
    half = truth.anatomy.half_width_mm
    entries = words["scans"]["loads"]
    assert [e["force_n"] for e in entries] == [load.force_n for load in truth.loads]
    for entry in entries:
        assert entry["axis"] == "y"
        assert (entry["lower_mm"], entry["upper_mm"]) == (-half, half)
        labels = read_volume_file(case / entry["volume"])
        assert labels.values.dtype == np.uint8
        assert set(np.unique(labels.values)) == {Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR}
        # Air on all sides, so that no interface is cut except at the chest wall.
        for axis in range(3):
            assert not labels.values.take([0, -1], axis=axis).any()


@pytest.mark.slow
def test_noise_has_the_given_size_and_correlation_length(body):
    labels = padded(body.labels, 6.0)
    hands = [segmented(labels, Segmenter(0.3), np.random.default_rng(s)) for s in (1, 2)]
    noise = noise_from_repeat(*hands, spacing_mm=3.0, clear_mm=1.5)
    assert noise.sd_mm == pytest.approx(0.3, rel=0.12)
    assert noise.correlation_mm == pytest.approx(4.0, rel=0.2)


def test_offsets_move_the_boundaries_by_their_size():
    # A ball of 15 mm that contains a glandular ball of 8 mm.
    axis = (np.arange(50) - 24.5) * 0.8
    far = np.sqrt(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2)
    values = (far < 15).astype(np.uint8) + (far < 8)
    labels = Volume(values, (0.8,) * 3, (axis[0],) * 3)
    drawn = segmented(labels, Segmenter(0.0, 0.5, -0.4), np.random.default_rng(0))

    def radius(inside):
        return (3 * np.count_nonzero(inside) * 0.8**3 / (4 * np.pi)) ** (1 / 3)

    grown = radius(drawn.values > 0) - radius(values > 0)
    shrunk = radius(drawn.values == 2) - radius(values == 2)
    assert grown == pytest.approx(0.5, abs=0.08)
    assert shrunk == pytest.approx(-0.4, abs=0.1)


def test_material_points_follow_a_quadratic_field_exactly(body):
    points = points_on(body.mesh, body.labels, 300, 7)
    assert set(points.interface) == {0, 1}
    assert points.points[:, 2].min() > 4

    def bent(x):
        return np.column_stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 0] - x[:, 1] * x[:, 2]]) / 50

    assert np.allclose(points.moved(bent(body.mesh.nodes)), bent(points.points), atol=1e-9)


def test_outside_points_are_in_no_element(body):
    corners = body.mesh.nodes[body.mesh.cells[5, :4]]
    inside = corners.mean(axis=0)
    cells, weights = locate(body.mesh, np.array([inside, [0, 0, 500.0]]))
    assert cells.tolist() == [5, -1]
    assert weights[0] == pytest.approx(0.25)


def test_fine_elements_fill_the_body_and_interpolate_a_quadratic_field(body):
    fine = fine_mesh_of(body.mesh)
    x = fine.mesh.nodes[fine.mesh.tets]
    six = np.linalg.det(x[:, 1:] - x[:, :1])
    whole = body.mesh.nodes[body.mesh.cells[:, :4]]
    assert len(six) == 64 * len(whole)
    assert six.min() > 0
    assert six.sum() == pytest.approx(np.linalg.det(whole[:, 1:] - whole[:, :1]).sum())
    # Neighbours share their nodes: a large mesh has about 10.7 tetrahedra per two nodes.
    assert len(fine.mesh.nodes) < len(six) / 4.5

    def bent(x):
        return np.column_stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 0] - x[:, 1] * x[:, 2]]) / 50

    assert np.allclose(fine.interpolation @ bent(body.mesh.nodes), bent(fine.mesh.nodes))


def test_body_at_rest_keeps_its_labels(body):
    still = np.zeros_like(body.mesh.nodes)
    rest = deformed_labels(glandular_share(body.labels), fine_mesh_of(body.mesh), still)
    ours = np.count_nonzero(rest.values == Tissue.GLANDULAR)
    theirs = np.count_nonzero(body.labels.values == Tissue.GLANDULAR)
    assert ours == pytest.approx(theirs, rel=0.01)
