"""Default physics shared by studies, diagnoses, plans and blind sets."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from palpate.service.export import TISSUE_NAMES, export_volume
from palpate.service.study.study_keys import StudySpec
from palpate.service.templates import template
from palpate.storage.values import Tissue, Volume
from palpate.workers.blind.case_files import write_case
from palpate.workers.blind.random_case import draw
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.model_parameters import BREAST
from palpate.workers.organs.breast.breast_keys import BreastCase, ModelSpec
from palpate.workers.organs.breast.breast_study_source import (
    TARGET_MESH,
    BreastStudy,
    BreastStudySource,
)
from palpate.workers.organs.breast.scan_facts import in_air
from palpate.workers.organs.breast.scanned_case import ScannedCase
from palpate.workers.organs.breast.scanned_case_files import read_case, read_case_file, understood
from palpate.workers.organs.breast.scanned_case_keys import CaseFile, CaseModel
from palpate.workers.organs.breast.scanned_case_source import PlannedCaseSource, ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.cases.filled_templates import filled, required, small_breast
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

FORCE_N = 12.0
FRAME = Frame((3.0, 7.5, 16.0), (28.0, 37.5, 16.0))
# Values that a study holds or searches around, under their names in a diagnosis.
DOOR_KPA = {
    "E_fat_kpa": 11.0,
    "E_glandular_kpa": 35.0,
    "eta_fat_kpa": 90.0,
    "eta_glandular_kpa": 140.0,
}
INTERVALS = ("E_fat_kpa", "E_glandular_kpa", "eta_fat_kpa", "eta_glandular_kpa")


def study_source(rest: Volume, pressed: Volume, **case: object) -> BreastStudySource:
    """Return a study of two images with only the required keys."""
    data = filled("breast-images", required("breast-images", FORCE_N))
    data["case"] |= case
    spec = StudySpec.model_validate(data)
    assert isinstance(spec.case, BreastCase)
    bounds = spec.case.parameters.bounds_from_door(spec.search.parameters)
    bodies = in_air(rest), in_air(pressed)
    return BreastStudySource(
        BreastStudy("mine", spec.case, bounds, {}, *bodies, {TARGET_MESH: None})
    )


def case_source(rest: Volume, pressed: Volume) -> ScannedCaseSource:
    """Return a diagnosis of two images with only the required keys."""
    file = CaseFile.model_validate(filled("diagnosis", required("diagnosis", FORCE_N)))
    return ScannedCaseSource(ScannedCase(file, in_air(rest), None, [in_air(pressed)]))


@pytest.fixture(scope="module")
def rest() -> Volume:
    return small_breast()


def test_a_study_and_a_diagnosis_of_the_same_scans_solve_the_same_problem(rest: Volume) -> None:
    study, case = study_source(rest, rest), case_source(rest, rest)
    values_mpa = {name.removesuffix("_kpa"): kpa / 1000 for name, kpa in DOOR_KPA.items()}
    searched = study.problem(0, FRAME)(values_mpa)
    renamed = {"E_gl" if n == "E_glandular" else n: v for n, v in values_mpa.items()}
    diagnosed = case.case.problem(0, FRAME)(renamed)
    for tissue in (Tissue.FAT, Tissue.GLANDULAR):
        assert diagnosed.constants[tissue] == searched.constants[tissue]
    assert without_tissues(diagnosed) == without_tissues(searched)
    assert searched.constants[Tissue.GLANDULAR].fibre_mpa == 0.140


def without_tissues(problem: Problem) -> list[object]:
    """Return all fields of a problem except the constants of its tissues."""
    return [getattr(problem, name) for name in problem.__slots__ if name != "constants"]


def test_a_study_and_a_diagnosis_of_the_same_scans_assume_the_same_noise(rest: Volume) -> None:
    study, case = study_source(rest, rest), case_source(rest, rest)
    assert case.segmentation_noise == study.segmentation_noise
    assert case.segmentation_noise.sd_mm == 0.5 * max(rest.spacing_mm)
    assert case.acquisition.pose_sd == study.acquisition.pose_sd


def test_a_plan_has_the_physics_of_the_diagnosis(rest: Volume) -> None:
    case = case_source(rest, rest)
    values = {"E_fat": 0.01, "E_gl": 0.04, "eta_fat": 0.1, "eta_glandular": 0.1}
    planned = PlannedCaseSource(
        ScannedCase(case.case.file, in_air(rest), None, [])
    ).acquisition.problem(0, FRAME)(values)
    assert planned == case.case.problem(0, FRAME)(values)


def test_both_models_have_the_same_defaults() -> None:
    study, diagnosis = ModelSpec(), CaseModel()
    for name in ("fibres", "fibre_invariant"):
        assert getattr(study, name) == getattr(diagnosis, name)
    assert (diagnosis.law, diagnosis.fibre_invariant) == ("fibre-neo-hookean", "I4")
    data = filled("diagnosis", required("diagnosis", 40.0))
    del data["constants"]["nu"]
    assert CaseFile.model_validate(data).nu == BREAST["nu"].neutral == 0.49


@pytest.mark.parametrize("kind", ["breast", "breast-images", "diagnosis"])
def test_templates_search_the_intervals_of_palpate_parameters(kind: str) -> None:
    data = yaml.safe_load(template(kind, "mine"))
    shown = data["constants"] if kind == "diagnosis" else data["search"]["parameters"]
    bounds = {name: BREAST.at_door(name) for name in INTERVALS}
    assert {n: tuple(ends) for n, ends in shown.items() if isinstance(ends, list)} == {
        n: (p.unit.to_door(p.lower), p.unit.to_door(p.upper)) for n, p in bounds.items()
    }


def test_a_diagnosis_of_a_study_takes_the_settings_of_the_study(rest: Volume) -> None:
    model = {"fibre_invariant": "isochoric", "fibres": "literal", "skin": "membrane"}
    study = study_source(rest, rest, model=model, constants={"nu": 0.47})
    again = BreastStudySource.from_content(study.content)
    problem = again.problem(0, FRAME)({"E_fat": 0.01})
    assert problem.isochoric_fibre and problem.literal_fibre
    assert problem.membrane is not None
    assert problem.constants[Tissue.FAT].poisson == 0.47


def test_a_blind_case_contains_its_physics_without_defaults(tmp_path: Path) -> None:
    truth = draw(4, "tilt", one_direction=True)
    write_case(truth, tmp_path / "case", tmp_path / "truth", corners=700, spacing_mm=1.5)
    file = read_case_file(tmp_path / "case" / "case.yaml")
    assert file.model.fibre_invariant == "isochoric"
    stated = set(CaseModel.model_fields)
    assert file.model.model_fields_set == stated
    assert file.wall.z_mm == 0 and file.wall.wall_hold_x_kpa_per_mm > 0
    assert file.noise is not None


def test_defaults_are_shown_before_a_diagnosis_runs() -> None:
    file = CaseFile.model_validate(filled("diagnosis", required("diagnosis", 40.0)))
    rows = dict(understood(file))
    assert rows["segmentation noise"] == (
        "not given: 0.5 voxels, correlated over 4 mm, in all scans"
    )
    assert rows["chest wall"] == (
        "where the body at rest begins, held along z, slides along x and y"
    )
    assert rows["scan 1"] == "pressed.nrrd: 40 N, plates start at the body in the scan at rest"
    assert rows["law"].endswith("in tension only, full (I4) stretch")


def test_defaults_are_shown_before_a_study_runs() -> None:
    data = filled("breast-images", required("breast-images", 40.0))
    del data["search"]["parameters"]["eta_glandular_kpa"]
    spec = StudySpec.model_validate(data)
    rows = dict(spec.case.understood([parameter["name"] for parameter in spec.free_parameters]))
    file = CaseFile.model_validate(filled("diagnosis", required("diagnosis", 40.0)))
    assert rows["law"] == dict(understood(file))["law"]
    assert rows["held"] == "eta_glandular 150 kPa (default), nu 0.49"


def test_plates_start_at_the_body_at_rest(rest: Volume) -> None:
    case = case_source(rest, rest).case
    occupied = np.flatnonzero((rest.values > 0).any(axis=(0, 2)))
    faces = rest.origin_mm[1] + rest.spacing_mm[1] * (occupied[[0, -1]] + np.array([-0.5, 0.5]))
    assert case.plate_starts_mm(case.loads[0]) == pytest.approx(tuple(faces))


def test_the_wall_is_where_the_body_at_rest_begins(tmp_path: Path, rest: Volume) -> None:
    case = case_on_disk(tmp_path, rest, rest, {})
    stated = case_on_disk(tmp_path, rest, rest, {"wall.z_mm": case.wall_mm})
    first = np.flatnonzero((rest.values > 0).any(axis=(1, 2)))[0]
    assert case.wall_mm == pytest.approx(rest.origin_mm[2] + (first - 0.5) * rest.spacing_mm[2])
    assert np.array_equal(case.reference.values, stated.reference.values)
    assert case.reference.origin_mm == stated.reference.origin_mm


def case_on_disk(
    folder: Path, rest: Volume, pressed: Volume, stated: dict[str, object]
) -> ScannedCase:
    for name, labels in (("rest", rest), ("pressed", pressed)):
        (folder / f"{name}.nrrd").unlink(missing_ok=True)
        export_volume(folder / f"{name}.nrrd", labels, TISSUE_NAMES)
    data = filled("diagnosis", required("diagnosis", FORCE_N) | stated)
    (folder / "case.yaml").write_text(yaml.safe_dump(data))
    return read_case(folder)


@pytest.mark.slow
def test_a_body_from_palpates_own_solver_shows_no_gap_with_defaults(
    tmp_path: Path, rest: Volume
) -> None:
    """The loaded scan is simulated with the default physics, on a different mesh."""
    control = case_on_disk(tmp_path, rest, rest, {})
    hierarchy = build_hierarchy(control.reference, nodes=2500)
    model = prepare(hierarchy)
    problem = control.problem(0, frame_of(model.finest.nodes))
    true = {"E_fat": 0.010, "E_gl": 0.040, "eta_fat": 0.100, "eta_glandular": 0.150}
    solved = solve(model, problem(true))
    assert solved.outcome.converged
    pressed = warp_labels(control.reference, hierarchy.finest.mesh, solved.displacement_mm)
    source = ScannedCaseSource(case_on_disk(tmp_path, rest, pressed, {}))
    check_source(source)
    found = diagnosis_in(diagnosed_store(source, tmp_path / "store", 2000)).verdict
    assert (found.kind, found.primary) == ("no-gap", ())
