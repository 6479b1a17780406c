"""A study as the source of a diagnosis: its model, its intervals, its own target."""

from pathlib import Path

import numpy as np
import pytest
from compressed_breast import PHANTOM

from storage.errors import InputError
from storage.values import Volume
from workers import pipeline
from workers.cases.study import StudyPieces, StudySource
from workers.diagnosis.calibrate import calibrate
from workers.diagnosis.diagnosis import diagnose, look, one_by_one
from workers.fem.model import prepare
from workers.images.one_body import in_air
from workers.organs.breast import extent_of
from workers.phantom.breast import generate_breast
from workers.spec import CaseSpec

TRUE_KPA = {"E_fat_kpa": 10.0, "eta_fat_kpa": 100.0, "E_glandular_kpa": 32.0}
BOUNDS_KPA = {
    "E_fat_kpa": (5.0, 20.0), "eta_fat_kpa": (50.0, 200.0), "E_glandular_kpa": (8.0, 80.0),
}  # fmt: skip
EFFECTS = ("plate_tilt", "gravity_change", "stiffness_gradient", "inclusion", "compressibility")


def case_of(nodes: int, **constants: float) -> CaseSpec:
    return CaseSpec.model_validate(
        {
            "reference": {"phantom": {"spacing_mm": 1.5}},
            "mesh": {"nodes": nodes},
            "load": {"force_n": 15},
            "constants": constants,
        }
    )


def pieces_of(
    hidden_kpa: dict[str, float], bounds_kpa: dict[str, tuple[float, float]], **held: float
) -> StudyPieces:
    """A study whose target was simulated on the mesh of its candidates."""
    case = case_of(1200, **held)
    reference = in_air(generate_breast(PHANTOM, seed=5).labels)
    mesh = pipeline.mesh(reference, case.mesh, case.model)
    hidden = case.complete(case.parameters.from_door(hidden_kpa))
    solved = pipeline.simulate(prepare(mesh), case, hidden, extent_of(reference))
    assert solved.outcome.converged
    target = pipeline.deform(reference, mesh.finest.mesh, solved.displacement_mm)
    return StudyPieces(
        name="small",
        case=case,
        bounds=case.parameters.bounds_from_door(bounds_kpa),
        best={"E_fat": 0.011},
        reference=reference,
        target=in_air(target),
        target_mesh=case.mesh,
        files=[Path("journal.jsonl")],
    )


@pytest.fixture(scope="module")
def own() -> StudySource:
    """The target of a study with hidden constants, and nothing else hidden."""
    return StudySource(pieces_of(TRUE_KPA, BOUNDS_KPA))


def test_a_target_with_hidden_constants_shows_no_gap(own: StudySource) -> None:
    subject, found = calibrate(own.subject(5000, 6.0), own.finer(14_000))
    linear = found.linearised(subject)
    A = linear.scaled_nominal
    sd = linear.nominal_sd * np.sqrt(np.diag(np.linalg.inv(np.eye(A.shape[1]) + A.T @ A)))
    true = np.log([1e-3 * kpa for kpa in TRUE_KPA.values()])
    assert [f.name for f in own.free] == [name.removesuffix("_kpa") for name in TRUE_KPA]
    assert (np.abs(found.z - true) < 3 * sd).all()
    assert (sd < 0.3).all()
    assert 0.1 < (linear.whitened_residual**2).mean() < 1.2
    effects = [e for e in own.effects if e.name in EFFECTS]
    seen = look(subject, found, effects)
    assert len(seen.findings) == len(EFFECTS)
    said = diagnose(seen, effects, one_by_one(seen)).verdict
    assert said.kind == "no-gap"
    assert said.no_gap > 0.5


def test_an_effect_that_the_study_lacks_is_found() -> None:
    """Plates were tilted by 6 degrees when the target was made."""
    tilted = StudySource(pieces_of(TRUE_KPA | {"tilt_depth_deg": 6.0}, BOUNDS_KPA))
    subject, found = calibrate(tilted.subject(5000, 6.0))
    effects = [e for e in tilted.effects if e.name in EFFECTS]
    seen = look(subject, found, effects)
    best = seen.findings[0]
    assert best.name == "plate_tilt"
    assert best.estimate[0] == pytest.approx(6.0, rel=0.3)
    said = diagnose(seen, effects, one_by_one(seen)).verdict
    assert (said.kind, said.primary) == ("effect", ("plate_tilt",))
    assert said.alarm > said.threshold


def test_the_mesh_of_the_study_is_that_of_its_target(own: StudySource) -> None:
    few = own.subject(300, 12.0)
    many = own.finer(20_000)
    np.testing.assert_array_equal(few.model.finest.nodes, many.finest.nodes)


def test_searched_parameters_are_free_and_others_held(own: StudySource) -> None:
    assert [f.name for f in own.free] == ["E_fat", "eta_fat", "E_glandular"]
    assert own.start == {"E_fat": 0.011}
    pieces = own.pieces
    searched = StudyPieces(
        **{name: getattr(pieces, name) for name in ("name", "case", "reference", "target")},
        bounds={"E_fat": (0.005, 0.02), "eta_fat": (0.0, 0.1), "tilt_depth": (-5.0, 5.0),
                "friction": (0.1, 0.5)},
        best={"E_fat": 0.01, "tilt_depth": 2.0},
        target_mesh=None,
        files=(),
    )  # fmt: skip
    source = StudySource(searched)
    assert {f.name: f.lower for f in source.free} == {
        "E_fat": 0.005, "eta_fat": 0.002, "friction": 0.1,
    }  # fmt: skip
    assert "plate_friction" not in [e.name for e in source.effects]
    assert "plate_tilt" in [e.name for e in source.effects]
    problem = source.problem(0, own.subject(300, 12.0).frame)(
        {f.name: f.upper for f in source.free}
    )
    assert problem.load.device.upper.tilt_deg[0] == 2.0
    assert problem.load.device.friction == 0.5
    # An image was drawn by somebody; a simulated target was not.
    assert source.noise.sd_mm == pytest.approx(0.75)
    assert own.noise.sd_mm == pytest.approx(0.375)


def test_a_study_without_positive_parameters_has_nothing_to_fit(own: StudySource) -> None:
    pieces = own.pieces
    named = {name: getattr(pieces, name) for name in pieces.__dataclass_fields__}
    with pytest.raises(InputError, match="a constant that is positive"):
        StudySource(StudyPieces(**named | {"bounds": {"tilt_depth": (-5.0, 5.0)}})).check()


def test_air_lies_around_the_body_but_not_below_the_wall() -> None:
    solid = Volume(np.ones((3, 4, 5), np.uint8), (1.0, 2.0, 3.0), (10.0, 20.0, 30.0))
    found = in_air(solid)
    assert found.values.shape == (7, 12, 13)
    assert found.origin_mm == (6.0, 12.0, 30.0)
    assert found.values[0, 4:8, 4:9].all()
    assert found.values.sum() == solid.values.sum()
