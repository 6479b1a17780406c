"""Consistency of the results of a fitted cornea with each other and with the truth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.service.cluster.task_dispatch import SingleProcess
from palpate.service.commands.studies.report import print_report
from palpate.service.commands.terminal_tables import make_console
from palpate.service.report.study.study_page import write_report
from palpate.service.results.identification import identification_from_tangents
from palpate.service.results.intervals import OtherProblems, SearchedConstants
from palpate.service.results.result_records import StudyResults
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import StudySpec
from palpate.storage.values import FitJson, FreeParameter
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.constant_doubts import derived, refitted_constants
from palpate.workers.organs.cornea.cornea_keys import (
    CORNEA,
    EYE_MOTION,
    CorneaCase,
    MeshSpec,
    nuisances,
)
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.cornea_problem import candidate_of, constants_of
from palpate.workers.organs.cornea.corneal_model import CorneaConstants
from palpate.workers.organs.cornea.identifiability import uniaxial_stress_mpa
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
INSIDE = {"mu1": 0.011, "alpha1": 30.0, "mu2": 0.035, "alpha2": 80.0}
TRUTH = CorneaConstants((0.011, 0.035), (30.0, 80.0))
SEARCHED = {
    "mu1_pa": [1000, 40_000],
    "alpha1": [5, 60],
    "mu2_pa": [5000, 60_000],
    "alpha2": [50, 150],
}
FREE: list[FreeParameter] = [
    {"name": "mu1", "lower": 1e-6, "upper": 0.04},
    {"name": "alpha1", "lower": 0.1, "upper": 100.0},
    {"name": "mu2", "lower": 1e-6, "upper": 0.04},
    {"name": "alpha2", "lower": 0.1, "upper": 100.0},
]
CASE: dict[str, Any] = {
    "organ": "cornea",
    "mesh": {"elements": 240},
    "load": {"iop_mmhg": 10.5, "jet": {"pressure_kpa": 15}},
}


def studied(folder: Path, evaluations: int, **changed: Any) -> StudyResults:
    """Run a study of X1 with a target simulated on a finer mesh."""
    search = {
        "strategy": "least-squares",
        "starts": 1,
        "parameters": SEARCHED,
        "fit_evaluations": evaluations,
    }
    spec = {
        "name": "eye",
        "case": CASE,
        "target": {"constants": X1, "mesh": {"elements": 720}},
        "search": search | changed,
    }
    study = Study(validated(StudySpec, spec, "eye"), folder / "eye", folder / "store")
    study.run(SingleProcess())
    return study_results(folder / "eye")


@pytest.fixture(scope="module")
def converged(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return studied(tmp_path_factory.mktemp("converged"), 40)


def truth_of(one: dict[str, Any]) -> float:
    """Return the true value of a derived quantity, in kPa."""
    if "stretch" not in one:
        return 1000 * TRUTH.shear_modulus_mpa
    return 1000 * float(uniaxial_stress_mpa(TRUTH, np.array([one["stretch"]]))[0])


def test_intervals_of_shear_modulus_and_stress_contain_the_truth(converged: StudyResults) -> None:
    shown = study_json(converged)["derived"]
    found = converged.findings["derived"]
    assert [one["name"].split(" at ")[0] for one in found] == ["G0", *4 * ["stress"]]
    for one in found:
        ends = shown[one["name"]]["interval"]
        assert ends["lower"] < truth_of(one) < ends["upper"]
        assert ends["lower"] <= one["value"] <= ends["upper"]
    g0 = shown["G0"]
    assert g0["quotable"]
    assert g0["unit"] == "kPa"
    assert g0["interval"]["upper"] / g0["interval"]["lower"] < 1.25


def test_constants_that_are_not_identifiable_are_not_quotable(converged: StudyResults) -> None:
    shown = study_json(converged)["estimates"]
    assert {name: one["quotable"] for name, one in shown.items()} == dict.fromkeys(shown, False)
    assert any("No single constant is known" in note for note in converged.findings["notes"])


def test_page_and_terminal_agree(
    converged: StudyResults, capsys: pytest.CaptureFixture[str]
) -> None:
    print_report(converged, make_console())
    printed = " ".join(capsys.readouterr().out.split())
    page = write_report(converged.folder).read_text(encoding="utf-8")
    assert "G0: " in printed
    assert "Quotable." in printed
    assert "Quote G0 = " in page
    assert "Quote mu" not in page
    assert "stress at a stretch of 1.0" in page
    assert "with 90 % intervals" in page


def test_no_interval_without_convergence(tmp_path: Path) -> None:
    results = studied(tmp_path, 3)
    record = study_json(results)
    assert "has not converged" in record["stopped"]
    shown = [*record["estimates"].values(), *record["derived"].values()]
    assert len(shown) == 9
    for one in shown:
        assert one["interval"] is None
        assert not one["quotable"]
        assert one["reasons"][0] == "the search has not converged"
        assert not any(" to " in reason for reason in one["reasons"])


def test_names_of_constants_are_independent_of_held_terms() -> None:
    """Term 1 is searched at an exponent above that of term 2, which is held at its default."""
    case = validated(CorneaCase, CASE)
    values = case.complete({"mu1": 0.006622, "alpha1": 95.0})
    assert (values["mu1"], values["alpha1"]) == (0.006622, 95.0)
    assert (values["mu2"], values["alpha2"]) == (CORNEA["mu2"].neutral, CORNEA["alpha2"].neutral)
    genes = {"mu1_pa": 6622.0, "alpha1": 95.0}
    assert case.canonical(genes) == genes
    swapped = {"mu1": 0.035, "alpha1": 80.0, "mu2": 0.011, "alpha2": 30.0}
    assert {n: v for n, v in case.complete(swapped).items() if n in INSIDE} == INSIDE


def test_interval_belongs_to_the_estimate(tmp_path: Path) -> None:
    """The term with the lower exponent is held; the other one is estimated."""
    case = CASE | {"constants": {"mu2_pa": 11000, "alpha2": 30}, "mesh": {"elements": 60}}
    spec = {
        "name": "eye",
        "case": case,
        "target": {"constants": {"mu1_pa": 35000, "alpha1": 80}},
        "search": {
            "strategy": "least-squares",
            "starts": 1,
            "parameters": {"mu1_pa": [1000, 60_000], "alpha1": [40, 120]},
        },
    }
    study = Study(validated(StudySpec, spec, "eye"), tmp_path / "eye", tmp_path / "store")
    study.run(SingleProcess())
    results = study_results(tmp_path / "eye")
    assert results.identification is not None
    for name, truth in (("mu1", 35_000), ("alpha1", 80)):
        one = results.estimates[name]
        assert one.target == truth
        assert one.estimate == pytest.approx(truth, rel=1e-3)
        assert results.identification.constants[name].estimate == pytest.approx(one.estimate)


def solved(case: CorneaCase, body: Section) -> tuple[Any, Any, Section]:
    """Return the mesh of a case, its model, and the section deformed with X1."""
    mesh = ORGAN.make_mesh(body, case)
    model = ORGAN.prepare(mesh)
    outcome = ORGAN.solve(model, candidate_of(model, case, case.complete(INSIDE), 0.0))
    return mesh, model, ORGAN.deform(body, mesh, outcome.displacement_mm)


def test_mesh_shift_equals_the_error_on_a_finer_mesh() -> None:
    case = validated(CorneaCase, CASE)
    body = ORGAN.make_body(case.reference)
    mesh, model, _ = solved(case, body)
    *_, finer = solved(case.model_copy(update={"mesh": MeshSpec(elements=4 * 240)}), body)
    moved = refitted_constants(model, case, body, case.complete(INSIDE), 0.0, FREE)
    assert moved is not None
    observation = ORGAN.observation(body, mesh, finer, False)
    before, after = (
        ORGAN.fit(model, case, values, FREE, 0.0, None, observation).residuals
        for values in (case.complete(INSIDE), moved)
    )
    assert before is not None
    assert after is not None
    assert after.equations.cost < 1e-2 * before.equations.cost
    ratio = constants_of(case, moved).shear_modulus_mpa / TRUTH.shear_modulus_mpa
    assert 0.8 < ratio < 1.2


def test_derived_values_have_the_slopes_of_their_formula() -> None:
    """The slopes are the shares of both terms in G0 = (mu1 alpha1 + mu2 alpha2) / 2."""
    numbers = {
        "constants": {"mu1_mpa": 0.011, "alpha1": 30.0, "mu2_mpa": 0.035, "alpha2": 80.0},
        "attained_stretches": [0.99, 1.04],
        "not_measured": [],
    }
    g0, *stresses = derived(numbers, TRUTH)
    first = 0.33 / 3.13
    assert g0["slope"] == pytest.approx(
        {"mu1": first, "alpha1": first, "mu2": 1 - first, "alpha2": 1 - first}, rel=1e-5
    )
    assert [one["stretch"] for one in stresses] == pytest.approx([1.01, 1.02, 1.03, 1.04])
    assert [one["value"] for one in stresses] == pytest.approx([truth_of(one) for one in stresses])


@pytest.mark.parametrize(
    "motion",
    [
        RigidMotion(shift_mm=(0.0, -0.2)),
        RigidMotion(tilt_rad=float(np.radians(2.0)), centre_mm=(0.0, -5.0)),
    ],
    ids=["0.2 mm into the orbit", "2 degrees"],
)
def test_a_motion_of_the_whole_eye_contradicts_the_estimates(motion: RigidMotion) -> None:
    case = validated(CorneaCase, CASE)
    body = ORGAN.make_body(case.reference)
    mesh, model, deformed = solved(case, body)

    def supported(target: Section) -> tuple[str, ...]:
        observation = ORGAN.observation(body, mesh, target, True)
        problems = []
        for free in (FREE, [*FREE, *(one.free for one in EYE_MOTION)]):
            values = case.complete(INSIDE)
            residuals = ORGAN.fit(model, case, values, free, 0.0, None, observation).residuals
            assert residuals is not None
            equations = residuals.equations
            fit: FitJson = {
                "parameters": [p["name"] for p in free],
                "logarithmic": [p["lower"] > 0 for p in free],
                "values": [values[p["name"]] for p in free],
                "residuals": equations.residuals,
                "rms_mm": 0.0,
                "cost": equations.cost,
                "gradient": equations.gradient.tolist(),
                "hessian": equations.hessian.tolist(),
                "noise": residuals.noise,
            }
            problems.append(fit)
        searched = SearchedConstants(CORNEA, {p["name"]: (p["lower"], p["upper"]) for p in FREE})
        others = OtherProblems(problems[1], nuisances(case, True))
        return identification_from_tangents(searched, 0, problems[0], others).supported

    assert supported(deformed) == ()
    assert supported(motion.of_section(deformed)) == (EYE_MOTION[0].group,)
    assert nuisances(case, False) == ()
