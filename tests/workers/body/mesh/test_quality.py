"""Quality measures of tetrahedra calculated by hand."""

import json

import numpy as np
import pytest

from palpate.storage.values import TetMesh
from palpate.workers.body.mesh.mesh_geometry import measures, summarise, volumes_mm3

REGULAR = np.array([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)], float)
CORNER = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
LATTICE = np.array([(0, 0, 0), (0.5, -0.5, -0.5), (0.5, 0.5, -0.5), (1, 0, 0)])


def one(nodes):
    return TetMesh(np.asarray(nodes, float), np.array([[0, 1, 2, 3]], np.int32))


def test_every_measure_of_the_regular_tetrahedron_is_one():
    summary = summarise(one(REGULAR))
    for name in ("M1", "M2", "M3", "M4", "aspect"):
        assert summary[name]["min"] == pytest.approx(1, rel=1e-12), name
    assert summary["M5"] == 1
    assert summary["volume_mm3"] == pytest.approx(8 / 3)  # a cube of 8 less four corners of 4/3


def test_measures_of_a_cube_corner_match_hand_calculation():
    # V = 1/6, areas 1/2 (three) and sqrt(3)/2: r = 3 V / A = 1 / (3 + sqrt 3); R = sqrt(3) / 2;
    # sum of squared edges 9; longest sqrt 2; shortest altitude 1 / sqrt 3.
    # Solid angle at (1, 0, 0): dihedral angles 90, 54.74, 54.74 degrees, minus 180 degrees.
    r = 1 / (3 + np.sqrt(3))
    solid = np.pi / 2 + 2 * np.arccos(1 / np.sqrt(3)) - np.pi
    expected = {
        "M1": 3 * r / (np.sqrt(3) / 2),
        "M2": 2 * np.sqrt(6) * r / np.sqrt(2),
        "M3": 12 * 0.5 ** (2 / 3) / 9,
        "M4": solid / 0.55129,
        "aspect": np.sqrt(2) * np.sqrt(3) / np.sqrt(1.5),
        "volume_mm3": 1 / 6,
    }
    computed = measures(one(CORNER))
    assert computed.keys() == expected.keys()
    for name, value in expected.items():
        assert computed[name][0] == pytest.approx(value, rel=1e-5), name


def test_measures_of_a_lattice_tetrahedron_match_hand_calculation():
    # Edges 1, 1 and four of sqrt(3)/2, V = 1/12, faces sqrt(2)/4: altitude 1 / sqrt 2.
    computed = measures(one(LATTICE))
    assert computed["volume_mm3"][0] == pytest.approx(1 / 12)
    assert computed["aspect"][0] == pytest.approx(np.sqrt(2 / 1.5))
    assert computed["M3"][0] == pytest.approx(12 * 0.25 ** (2 / 3) / 5)


def test_measures_do_not_depend_on_position_rotation_and_size():
    rng = np.random.default_rng(5)
    nodes = rng.standard_normal((4, 3))
    if volumes_mm3(one(nodes))[0] < 0:
        nodes = nodes[[0, 1, 3, 2]]
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    before, after = measures(one(nodes)), measures(one(7 * nodes @ turn + 100))
    for name in ("M1", "M2", "M3", "M4", "aspect"):
        assert after[name][0] == pytest.approx(before[name][0], rel=1e-9), name


def test_flat_tetrahedron_is_worse_and_inverted_one_has_negative_volume():
    flat = CORNER * (1, 1, 0.01)
    for name in ("M1", "M2", "M3", "M4"):
        assert measures(one(flat))[name][0] < 0.3 * measures(one(CORNER))[name][0], name
    assert measures(one(flat))["aspect"][0] > 50
    assert measures(one(CORNER[[0, 2, 1, 3]]))["M3"][0] < 0


def test_summary_is_plain_json():
    both = TetMesh(
        np.concatenate([REGULAR, CORNER]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]], np.int32)
    )
    summary = json.loads(json.dumps(summarise(both), allow_nan=False))
    assert (summary["nodes"], summary["tets"], summary["bad"]) == (8, 2, 0)
    assert summary["M5"] == pytest.approx((1 / 6) / (8 / 3))
    assert summary["aspect"]["mean"] == pytest.approx(1.5)
    assert summary["aspect"]["max"] == pytest.approx(2)
