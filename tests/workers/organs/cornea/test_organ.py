"""The cornea as an organ: the same tasks as for a breast, from a case to a score."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.cornea_keys import CorneaCase, CorneaScore
from palpate.workers.organs.cornea.cornea_organ import CORNEA_LABEL, ORGAN
from palpate.workers.organs.cornea.corneal_model import CorneaConstants, CorneaLoad, CorneaModel
from palpate.workers.organs.cornea.section_mesh import mesh_section
from palpate.workers.organs.cornea.section_outline import RigidMotion, generated_section
from palpate.workers.tasks import study_tasks
from tests.workers.organs.cornea.frames.generated_frame import generated_frame
from tests.workers.organs.cornea.solver.solved import solve_cornea

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
CASE: dict[str, Any] = {"organ": "cornea", "mesh": {"elements": 240}}
PIXEL_MM = (0.015625, 0.0165)


def evaluated(case: dict[str, Any], target: str, store: Path, constants: dict[str, float]) -> Any:
    prepared = study_tasks.prepare_case(case, str(store))
    spec = validated(CorneaCase, case)
    return study_tasks.evaluate(
        {
            "store": str(store),
            "case": case,
            "prepared": prepared,
            "target": target,
            "constants": spec.parameters.from_door(constants),
            "keep_volume": True,
        }
    )


def test_candidate_with_the_target_constants_matches_the_target(tmp_path: Path) -> None:
    made = study_tasks.make_target(CASE, {"constants": X1}, str(tmp_path))
    same = evaluated(CASE, made["target"], tmp_path, X1)
    assert same["score"]["jc"] == 1.0
    assert same["score"]["mhd_mm"] == pytest.approx(0.0, abs=1e-9)
    swapped = {"mu1_pa": 35000.0, "alpha1": 80.0, "mu2_pa": 11000.0, "alpha2": 30.0}
    assert evaluated(CASE, made["target"], tmp_path, swapped)["digest"] == same["digest"]
    other = evaluated(CASE, made["target"], tmp_path, X1 | {"mu2_pa": 20000.0})
    assert other["score"]["gsf"] > 0
    parts = study_tasks.score_bodies(CASE, str(tmp_path), made["target"], other["digest"])
    assert parts["cornea"] == other["score"]


def test_tasks_match_the_solver(tmp_path: Path) -> None:
    made = study_tasks.make_target(CASE, {"constants": X1}, str(tmp_path))
    mesh = mesh_section(generated_section(), 240, (-1.5, 0.0, 1.5))
    constants = CorneaConstants((0.011, 0.035), (30.0, 80.0))
    load = CorneaLoad(10.5 * 1.33322387e-4)
    solution = solve_cornea(mesh, constants, load, CorneaModel())
    apex = made["outcome"]["apex_displacement_um"]
    assert apex == pytest.approx(solution.apex_displacement_um, rel=1e-9)


def test_divergent_prestress_is_an_ordinary_outcome(tmp_path: Path) -> None:
    soft = {"mu1_pa": 20.0, "alpha1": 2.0, "mu2_pa": 20.0, "alpha2": 2.0}
    with pytest.raises(InputError, match=r"cannot be simulated: .*(prestress|pressure of the eye)"):
        study_tasks.make_target(CASE, {"constants": soft}, str(tmp_path))
    made = study_tasks.make_target(CASE, {"constants": X1}, str(tmp_path))
    ending = evaluated(CASE, made["target"], tmp_path, soft)
    assert ending["status"] == "diverged"
    assert ending["score"] is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"load": {"jet": {"pressure_kpa": 15, "diameter_mm": 13}}}, "jet wider than the cornea"),
        ({"load": {"jet": {"pressure_kpa": 15, "centre_mm": 6}}}, "off it"),
        ({"reference": {"section": {"central_mm": 4}}}, "leave no posterior arc"),
        ({"reference": {"section": {"chord_mm": 16}}}, "does not reach a diameter"),
        (
            {"reference": {"frame": {"file": "nowhere.png", "pixel_mm": [0.01, 0.01]}}},
            "nowhere.png",
        ),
    ],
)
def test_rejects_impossible_cases(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        study_tasks.prepare_case(CASE | changes, str(tmp_path))


def test_rejects_an_image_without_a_cornea(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = np.clip(8 + 2 * rng.standard_normal((240, 576)), 0, 255)
    Image.fromarray(noise.astype(np.uint8)).save(tmp_path / "dark.png")
    frame = {"file": str(tmp_path / "dark.png"), "pixel_mm": PIXEL_MM}
    with pytest.raises(InputError, match="surface of a cornea is visible in"):
        study_tasks.prepare_case(CASE | {"reference": {"frame": frame}}, str(tmp_path / "store"))


def test_section_survives_a_round_trip_through_an_image(tmp_path: Path) -> None:
    """Without refraction, to a fraction of a pixel; the window crops to the frame's extent."""
    truth = RigidMotion((4.5, -2.9)).of_section(generated_section(points=1001))
    frame = generated_frame(truth, PIXEL_MM, (240, 576), seed=3)
    Image.fromarray(frame.grey.astype(np.uint8)).save(tmp_path / "rest.png")
    seen = {"file": str(tmp_path / "rest.png"), "pixel_mm": PIXEL_MM, "refraction": None}
    case = validated(CorneaCase, CASE | {"reference": {"frame": seen}})
    body = ORGAN.make_body(case.reference)
    score = ORGAN.scorer(body, CorneaScore(window_mm=(0.5, 8.5))).score(truth).as_dict()
    assert score["mhd_mm"] < 0.005
    assert score["jc"] > 0.98
    assert ORGAN.facts(body, ORGAN.make_mesh(body, case))["central_thickness_um"] == pytest.approx(
        595, abs=10
    )


def test_the_picture_of_a_section_has_its_area() -> None:
    section = generated_section()
    picture = ORGAN.picture(section)
    x, y = section.outline_mm.T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert picture.values.shape[0] == 1
    assert (picture.values == CORNEA_LABEL).sum() * 1e-4 == pytest.approx(area, rel=2e-3)


def test_bodies_and_meshes_survive_a_round_trip_through_the_store() -> None:
    section = generated_section()
    back = ORGAN.body_from_arrays(ORGAN.body_to_arrays(section))
    np.testing.assert_array_equal(back.outline_mm, section.outline_mm)
    mesh = ORGAN.make_mesh(section, validated(CorneaCase, CASE))
    again = ORGAN.mesh_from_arrays(ORGAN.mesh_to_arrays(mesh))
    np.testing.assert_array_equal(again.triangles, mesh.triangles)
    np.testing.assert_array_equal(again.nodes_mm, mesh.nodes_mm)
