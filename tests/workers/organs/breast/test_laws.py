"""The law of a breast's tissue: valid keys, and recovery of its shape."""

import pickle
from typing import Any

import numpy as np
import pytest

from palpate.service.study.study_keys import StudySpec
from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.polynomial_laws import Yeoh
from palpate.workers.organs.breast.breast_keys import BreastCase
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_problem import problem_of
from palpate.workers.organs.breast.scanned_case_keys import CaseFile

E = {"E_fat_kpa": [5, 20], "E_glandular_kpa": [20, 50]}


def case_of(law: Any, load: Any = None, **constants: float) -> BreastCase:
    data = {
        "reference": {"phantom": {"spacing_mm": 2.0}},
        "mesh": {"nodes": 900},
        "model": {"law": law},
        "load": load or {"force_n": 40},
        "constants": constants,
    }
    return validated(BreastCase, data, "The case")


def scans_of(law: Any, **constants: Any) -> CaseFile:
    scans = {"reference": "rest.nrrd", "loads": [{"volume": "a.nrrd", "force_n": 40}]}
    data = {"name": "mine", "model": {"law": law}, "constants": E | constants, "scans": scans}
    return validated(CaseFile, data, "The file")


def laws_in(case: BreastCase) -> dict[Tissue, Any]:
    problem = problem_of(case.model, case.load, case.complete(), (0.0, 60.0))
    return {tissue: c.law for tissue, c in problem.constants.items()}


def test_one_name_applies_to_all_tissues() -> None:
    case = case_of("yeoh", yeoh_c2_fat=1.5, E_fat_kpa=8)
    laws = laws_in(case)
    mu = 0.008 / (2 * 1.49)
    assert laws[Tissue.FAT] == laws[Tissue.LIGAMENT] == Yeoh(mu / 2, 1.5 * mu, 0.0)
    assert isinstance(laws[Tissue.MUSCLE], Yeoh)
    assert laws[Tissue.GLANDULAR].c2_mpa == 0
    assert case == case_of({"fat": "yeoh", "glandular": "yeoh"}, yeoh_c2_fat=1.5, E_fat_kpa=8)


def test_a_vocabulary_is_made_once_and_belongs_to_one_case() -> None:
    case, plain = case_of("yeoh"), case_of("yeoh")
    assert case.parameters is case.parameters
    assert "yeoh_c2_fat" in case.parameters
    assert "E_skin" not in case.parameters
    model = validated(BreastCase, {"reference": {"phantom": {}}, "model": {"skin": "membrane"}})
    assert "E_skin" in model.parameters
    for deep in (False, True):
        changed = case.model_copy(update={"model": model.model}, deep=deep)
        assert changed.parameters.names == model.parameters.names
        assert changed.simulated["model"] == model.simulated["model"]
    assert case == plain == pickle.loads(pickle.dumps(case))
    assert hash(case.model) == hash(plain.model)
    assert case.model_dump() == plain.model_dump()
    assert repr(case) == repr(plain)


def test_unnamed_tissues_stay_neo_hookean() -> None:
    laws = laws_in(case_of({"glandular": "fung"}, fung_b_glandular=3))
    assert laws[Tissue.FAT] is None
    assert isinstance(laws[Tissue.GLANDULAR], Fung)


def test_the_default_law_is_not_written() -> None:
    """So that the digests of older studies do not change."""
    assert "law" not in case_of("neo-hookean").model_dump(mode="json")["model"]
    assert case_of("neo-hookean").complete() == case_of({}).complete()
    kept = case_of("yeoh").model_dump(mode="json")
    assert validated(BreastCase, kept, "It") == case_of("yeoh")


@pytest.mark.parametrize(
    ("law", "constants", "words"),
    [
        ("yeo", {}, "did you mean 'yeoh'"),
        ({"fad": "yeoh"}, {}, "did you mean 'fat'"),
        ({"fat": "yeo"}, {}, r"model\.law\.fat: unknown law 'yeo'"),
        ("yeoh", {"fung_b_fat": 2}, "belongs to the law fung, but the law of fat is yeoh"),
        ({"fat": "fung"}, {"fung_b_glandular": 2}, "the law of glandular is neo-hookean"),
        ("yeoh", {"yeoh_c4_fat": 2}, "did you mean 'yeoh_c"),
        ("fung", {"fung_b_fat": -2}, "must be at least 0"),
        ("fung", {"stiffening": 2}, "its shape constants define how the tissue stiffens"),
    ],
)
def test_rejects_invalid_values(law: Any, constants: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        case_of(law, **constants)


def study_of(law: Any, parameters: dict[str, list[float]]) -> StudySpec:
    data = {
        "name": "laws",
        "case": {"reference": {"phantom": {}}, "load": {"force_n": 40}, "model": {"law": law}},
        "target": {"constants": {"E_fat_kpa": 9}},
        "search": {"parameters": parameters},
    }
    return validated(StudySpec, data, "The study")


def test_shape_constants_are_searched_only_if_the_law_has_them() -> None:
    study = study_of({"fat": "fung"}, {"E_fat_kpa": [5, 20], "fung_b_fat": [0, 9]})
    assert study.free_parameters[-1] == {"name": "fung_b_fat", "lower": 0, "upper": 9}
    assert "fung_b_fat" in dict(study.case.understood(set()))["held"]
    assert "Fung in fat, neo-Hookean in glandular" in dict(study.case.understood(set()))["law"]
    with pytest.raises(InputError, match="belongs to the law yeoh, but the law of fat is fung"):
        study_of("fung", {"yeoh_c2_fat": [0, 1]})
    with pytest.raises(InputError, match="shape constants define how"):
        study_of("fung", {"stiffening": [0, 1]})
    assert study_of({"fat": "fung"}, {"stiffening": [0, 1]}).free_parameters


def test_cases_and_studies_specify_laws_alike() -> None:
    file = scans_of("yeoh", yeoh_c2_fat=[0.1, 2])
    assert not file.has_fibres
    assert file.free["yeoh_c2_fat"] == (0.1, 2.0)
    assert scans_of("yeoh", eta_kpa=100).has_fibres
    assert "strain_stiffening" not in {e.name for e in file.model.laws.suspects}
    assert "strain stiffening" in dict(file.model.laws.not_simulated or ())
    assert scans_of("fibre-neo-hookean", eta_kpa=100).model.laws.not_simulated is None
    with pytest.raises(InputError, match="the law of fat is neo-hookean"):
        scans_of("neo-hookean", yeoh_c2_fat=1)
    with pytest.raises(InputError, match="did you mean 'yeoh'"):
        scans_of("yeo")


def test_derivatives_find_modulus_and_shape() -> None:
    """Gauss-Newton from far off, on the residuals and tangents of a least-squares search."""
    case = case_of({"fat": "fung"}, eta_fat_kpa=50)
    names = ["E_fat", "fung_b_fat"]
    free = [
        {"name": "E_fat", "lower": 0.005, "upper": 0.02},
        {"name": "fung_b_fat", "lower": 0.0, "upper": 10.0},
    ]
    body = ORGAN.make_body(case.reference)
    mesh = ORGAN.make_mesh(body, case)
    model, ends = ORGAN.prepare(mesh), ORGAN.landmarks(body, case)
    truth = case.complete({"E_fat": 0.01, "fung_b_fat": 4.0})
    solved = ORGAN.solve(model, ORGAN.problem(model, case, truth, ends))
    target = ORGAN.deform(body, mesh, solved.displacement_mm)
    seen = ORGAN.observation(body, mesh, target, False)
    log_E, b = np.log(0.0125), 2.0
    for _ in range(4):
        values = truth | dict(zip(names, (float(np.exp(log_E)), float(b)), strict=True))
        fitted = ORGAN.fit(model, case, values, free, ends, None, seen)  # type: ignore[arg-type]
        assert fitted.residuals is not None
        e = fitted.residuals.equations
        step = np.linalg.solve(e.hessian, e.gradient)
        log_E, b = log_E - step[0], b - step[1]
    assert np.exp(log_E) == pytest.approx(0.01, rel=0.01)
    assert b == pytest.approx(4.0, rel=0.03)
