"""A study as the source of a diagnosis: its model, its intervals, its own target."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_problem import extent_of
from palpate.workers.organs.breast.breast_study_source import (
    TARGET_MESH,
    BreastStudy,
    BreastStudySource,
)
from palpate.workers.organs.breast.scan_facts import in_air
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.service.diagnosis.compressed_breast import PHANTOM
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

TRUE_KPA = {"E_fat_kpa": 10.0, "eta_fat_kpa": 100.0, "E_glandular_kpa": 32.0}
BOUNDS_KPA = {
    "E_fat_kpa": (5.0, 20.0),
    "eta_fat_kpa": (50.0, 200.0),
    "E_glandular_kpa": (8.0, 80.0),
}
EFFECTS = ("plate_tilt", "gravity_change", "stiffness_gradient", "inclusion", "compressibility")


def case_of(nodes: int, **constants: float) -> BreastCase:
    return BreastCase.model_validate(
        {
            "reference": {"phantom": {"spacing_mm": 1.5}},
            "mesh": {"nodes": nodes},
            "load": {"force_n": 15},
            "constants": constants,
        }
    )


def pieces_of(
    hidden_kpa: dict[str, float], bounds_kpa: dict[str, tuple[float, float]], **held: float
) -> BreastStudy:
    """A study whose target was simulated on the mesh of its candidates."""
    case = case_of(1200, **held)
    reference = in_air(generate_breast(PHANTOM, seed=5).labels)
    mesh = ORGAN.make_mesh(reference, case)
    hidden = case.complete(case.parameters.from_door(hidden_kpa))
    model = prepare(mesh)
    solved = ORGAN.solve(model, ORGAN.problem(model, case, hidden, extent_of(reference)))
    assert solved.outcome.converged
    target = ORGAN.deform(reference, mesh, solved.displacement_mm)
    return BreastStudy(
        name="small",
        case=case,
        bounds=case.parameters.bounds_from_door(bounds_kpa),
        best={"E_fat": 0.011},
        reference=reference,
        target=in_air(target),
        own={TARGET_MESH: case.mesh.model_dump(mode="json")},
    )


@pytest.fixture(scope="module")
def own() -> BreastStudySource:
    """The target of a study with hidden constants, and nothing else hidden."""
    return BreastStudySource(pieces_of(TRUE_KPA, BOUNDS_KPA))


def test_a_target_with_hidden_constants_shows_no_gap(
    own: BreastStudySource, tmp_path: Path
) -> None:
    """None of all the effects that a breast may lack is named."""
    store = diagnosed_store(own, tmp_path / "store", 5000, 6.0)
    inverse, found = store.inverse, store.nominal
    linear = found.linearised(inverse)
    A = linear.scaled_nominal
    sd = linear.nominal_sd * np.sqrt(np.diag(np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)))
    true = np.log([1e-3 * kpa for kpa in TRUE_KPA.values()])
    assert [f.name for f in own.free] == [name.removesuffix("_kpa") for name in TRUE_KPA]
    assert (np.abs(found.z - true) < 3 * sd).all()
    assert (sd < 0.3).all()
    assert 0.1 < (linear.whitened_residual**2).mean() < 1.2
    assert len(store.analysis.screening) > len(EFFECTS)
    said = diagnosis_in(store).verdict
    assert said.kind == "no-gap"
    assert said.gain < 5.0
    assert said.left_gain < 0.0


@pytest.mark.slow
def test_an_effect_that_the_study_lacks_is_found(tmp_path: Path) -> None:
    """Plates were tilted by 6 degrees when the target was made."""
    tilted = BreastStudySource(pieces_of(TRUE_KPA | {"tilt_depth_deg": 6.0}, BOUNDS_KPA))
    store = diagnosed_store(tilted, tmp_path / "store", 5000, 6.0, EFFECTS)
    best = store.analysis.screening[0]
    assert best.name == "plate_tilt"
    assert best.estimate[0] == pytest.approx(6.0, rel=0.3)
    said = diagnosis_in(store).verdict
    assert (said.kind, said.primary) == ("effect", ("plate_tilt",))


def test_study_and_target_share_the_mesh(own: BreastStudySource) -> None:
    few = own.inverse_problem(300, 12.0)
    many = own.finer(20_000)
    np.testing.assert_array_equal(few.model.finest.nodes, many.finest.nodes)


def test_searched_parameters_are_free_and_others_held(own: BreastStudySource) -> None:
    assert [f.name for f in own.free] == ["E_fat", "eta_fat", "E_glandular"]
    searched = replace(
        own.study,
        bounds={
            "E_fat": (0.005, 0.02),
            "eta_fat": (0.0, 0.1),
            "tilt_depth": (-5.0, 5.0),
            "friction": (0.1, 0.5),
        },
        best={"E_fat": 0.01, "tilt_depth": 2.0},
        own={TARGET_MESH: None},
    )
    source = BreastStudySource(searched)
    assert {f.name: f.lower for f in source.free} == {
        "E_fat": 0.005,
        "eta_fat": 0.002,
        "friction": 0.1,
    }
    assert "plate_friction" not in [e.name for e in source.effects]
    assert "plate_tilt" in [e.name for e in source.effects]
    problem = source.problem(0, own.inverse_problem(300, 12.0).frame)(
        {f.name: f.upper for f in source.free}
    )
    assert problem.load.device.upper.tilt_deg[0] == 2.0
    assert problem.load.device.friction == 0.5
    # An image was drawn by somebody; a simulated target was not.
    assert source.noise.sd_mm == pytest.approx(0.75)
    assert own.noise.sd_mm == pytest.approx(0.375)


def test_a_study_without_positive_parameters_has_nothing_to_fit(own: BreastStudySource) -> None:
    study = replace(own.study, bounds={"tilt_depth": (-5.0, 5.0)})
    with pytest.raises(InputError, match="needs a positive constant"):
        check_source(BreastStudySource(study))


def test_air_surrounds_the_body_except_below_the_wall() -> None:
    solid = Volume(np.ones((3, 4, 5), np.uint8), (1.0, 2.0, 3.0), (10.0, 20.0, 30.0))
    found = in_air(solid)
    assert found.values.shape == (7, 12, 13)
    assert found.origin_mm == (6.0, 12.0, 30.0)
    assert found.values[0, 4:8, 4:9].all()
    assert found.values.sum() == solid.values.sum()
