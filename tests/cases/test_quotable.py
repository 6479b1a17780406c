"""Rules for quotable estimates, for studies, corneas and diagnoses."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palpate.service.commands.studies.report import derived_text
from palpate.service.diagnosis.diagnosed_constants import judged_constants, summary_json
from palpate.service.number_formatting import NONE
from palpate.service.report.diagnosis.diagnosis_tables import constant_table
from palpate.service.results.identification import (
    Identification,
    identification_from_scatter,
    identification_from_tangents,
)
from palpate.service.results.intervals import (
    DECISIVE,
    MESH,
    OtherProblems,
    SearchedConstants,
    in_words,
)
from palpate.service.results.physical_limits import limited_reach
from palpate.service.results.quotability_rule import EstimateFacts, quotability
from palpate.service.results.result_records import (
    ParameterEstimate,
    StudyResults,
    derived_estimates,
    no_better,
)
from palpate.service.results.results_as_json import study_json
from palpate.storage.errors import InputError
from palpate.storage.json_digests import from_json
from palpate.storage.values import FitJson
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.mechanics.model_parameters import BREAST, Vocabulary
from palpate.workers.organs.cornea.constant_doubts import against, derived
from palpate.workers.organs.cornea.cornea_keys import CORNEA
from palpate.workers.organs.cornea.corneal_model import CorneaConstants
from palpate.workers.organs.organ_protocol import Nuisance
from tests.service.report.study_data_at_hand import results

GOOD = EstimateFacts(value=10.0, unit="kPa", searched=(5.0, 20.0), interval=(9.5, 10.5))
BOUNDS = {"E_fat": (0.005, 0.02), "eta_fat": (0.05, 0.2)}


def reasons(**changed: Any) -> tuple[str, ...]:
    answer = quotability(replace(GOOD, **changed))
    assert answer.quotable is not bool(answer.reasons)
    return answer.reasons


def test_a_good_estimate_is_quotable() -> None:
    assert reasons() == ()


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"value": 5.0}, "at the lower bound of the searched interval (5 kPa)"),
        ({"value": 19.9}, "at the upper bound of the searched interval (20 kPa)"),
        ({"value": 21.0}, "beyond the upper bound of the searched interval (20 kPa)"),
        ({"stated": (20.0, 50.0)}, "outside its stated interval (20 to 50 kPa)"),
        ({"interval": None}, "no interval is known"),
        ({"identifiable": "weak", "interval": (5.0, 15.0)}, "weakly determined, 5 to 15 kPa"),
        ({"identifiable": "ratio"}, "only its ratio to the other stiffnesses can be found"),
        ({"converged": False}, "the search has not converged"),
        (
            {"no_better_than": "the undeformed body"},
            "the best fit is no better than the undeformed body",
        ),
        ({"residual_factor": 7.0}, "the residual is 7 times the stated noise (at most 2 times)"),
        ({"contradictions": ("another statement says otherwise",)}, "another statement says"),
        ({"finished": False}, "the search has not finished"),
        ({"value": None}, "nothing was estimated"),
        ({"value": math.nan}, "nothing was estimated"),
    ],
)
def test_each_failed_criterion_has_a_reason(changed: dict[str, Any], reason: str) -> None:
    assert any(one.startswith(reason) for one in reasons(**changed)), reasons(**changed)


def test_all_reasons_are_given_at_once() -> None:
    found = reasons(value=5.0, converged=False, stated=(20.0, 50.0), residual_factor=9.0)
    assert len(found) == 4


def test_withholds_the_interval_of_a_search_that_has_not_converged() -> None:
    assert not quotability(replace(GOOD, converged=False)).interval_holds
    assert quotability(GOOD).interval_holds


# --- a study -------------------------------------------------------------------------------


def fit(gradient: tuple[float, float] = (0.0, 0.0), **changed: Any) -> FitJson:
    """Return a fit with standard deviations of 1 % and 5 % and residuals at the noise level."""
    found: dict[str, Any] = {
        "parameters": list(BOUNDS),
        "logarithmic": [True, True],
        "values": [0.01, 0.1],
        "residuals": 202,
        "rms_mm": 0.1,
        "cost": 200.0,
        "gradient": list(gradient),
        "hessian": [[1e4, 0.0], [0.0, 400.0]],
        "noise": "a test",
    }
    return found | changed  # type: ignore[return-value]


def identified(problem: FitJson, others: OtherProblems | None = None) -> Identification:
    return identification_from_tangents(SearchedConstants(BREAST, BOUNDS), 0, problem, others)


def studied(found: Identification, **changed: Any) -> StudyResults:
    """Return a study with the estimates of an identification."""
    estimates = {
        name: ParameterEstimate(f"{name}_kpa", "kPa", 1e3 * low, 1e3 * high, one.estimate, None)
        for (name, (low, high)), one in zip(BOUNDS.items(), found.constants.values(), strict=True)
    }
    return results(estimates=estimates, identification=found, **changed).judged


def test_estimate_at_a_bound_is_not_quotable() -> None:
    """E_fat is searched from 12 to 20 kPa and is 10 kPa: the search ends at 12 kPa."""
    bounds = BOUNDS | {"E_fat": (0.012, 0.020)}
    problem = fit(gradient=(2000.0, 0.0), values=[0.012, 0.1])
    found = identification_from_tangents(SearchedConstants(BREAST, bounds), 0, problem)
    estimates = {
        "E_fat": ParameterEstimate("E_fat_kpa", "kPa", 12.0, 20.0, 12.0, 10.0),
        "eta_fat": ParameterEstimate("eta_fat_kpa", "kPa", 50.0, 200.0, 100.0, 100.0),
    }
    record = study_json(results(estimates=estimates, identification=found).judged)
    assert record["estimates"]["E_fat"]["quotable"] is False
    assert record["estimates"]["E_fat"]["reasons"] == [
        "at the lower bound of the searched interval (12 kPa)"
    ]
    assert record["estimates"]["eta_fat"]["quotable"] is True


def test_a_constant_that_depends_on_one_at_its_bound_is_not_quotable() -> None:
    hessian = [[1e4, 1600.0], [1600.0, 400.0]]  # correlation of the errors: -0.8
    found = identified(fit(values=[0.02, 0.1], hessian=hessian))
    answer = studied(found).estimates["eta_fat"]
    assert answer.reasons == ("it depends on E_fat, which is at a bound of its searched interval",)


def test_a_fit_no_better_than_the_undeformed_body_has_no_estimate() -> None:
    before, after = {"glandular": {"gsf": -2.0}}, {"glandular": {"gsf": -1.5}}
    assert no_better(before, after, ["glandular"])
    assert not no_better(after, before, ["glandular"])
    found = studied(identified(fit()), undeformed_scores=before, best_scores=after)
    for estimate in found.estimates.values():
        assert estimate.estimate is None
        assert estimate.interval is None
        assert "the best fit is no better than the undeformed body" in estimate.reasons


def test_a_step_out_of_the_interval_withholds_the_interval() -> None:
    """The Gauss-Newton step is ten standard deviations: the best candidate is not the optimum."""
    found = studied(identified(fit(gradient=(-1000.0, 0.0))))
    for estimate in found.estimates.values():
        assert estimate.interval is None
        assert "the search has not converged" in estimate.reasons
    record = study_json(found)
    assert record["identification"]["constants"]["E_fat"]["interval"] is None


def test_residual_above_the_noise_widens_intervals_and_is_reported() -> None:
    one = identified(fit()).constants["E_fat"].interval
    three = identified(fit(cost=9 * 200.0)).constants["E_fat"].interval
    assert one is not None
    assert three is not None
    wider = math.log(three.upper / three.lower) / math.log(one.upper / one.lower)
    assert wider == pytest.approx(3.0)
    assert studied(identified(fit(cost=9 * 200.0))).estimates["E_fat"].reasons == (
        "the residual is 3 times the stated noise (at most 2 times)",
    )


def test_an_unfinished_search_has_no_interval() -> None:
    found = studied(identified(fit()), state="interrupted", stop_reason=None)
    assert found.estimates["E_fat"].interval is None
    assert not found.estimates["E_fat"].quotable


# --- an estimate at its physical limit -------------------------------------------------------

FROM_ZERO = {"E_fat": (0.005, 0.02), "eta_fat": (0.0, 0.1)}
SHARED = 0.8  # correlation of the errors: more fibres, less of E_fat
ETA_SD, E_SD = 0.007, 0.02


def without_fibres(eta_step: float, eta_mpa: float = 0.0) -> FitJson:
    """Return a fit near eta = 0 whose unlimited optimum is `eta_step` MPa higher."""
    covariance = np.array([[1.0, -SHARED], [-SHARED, 1.0]]) * np.outer(
        [E_SD, ETA_SD], [E_SD, ETA_SD]
    )
    hessian = np.linalg.inv(covariance)
    # Along the valley: E_fat is at its optimum for this eta.
    step = np.array([-SHARED * E_SD / ETA_SD * eta_step, eta_step])
    return fit(
        values=[0.01, eta_mpa],
        logarithmic=[True, False],
        hessian=hessian.tolist(),
        gradient=(-hessian @ step).tolist(),
    )


def from_zero(problem: FitJson) -> StudyResults:
    known = identification_from_tangents(SearchedConstants(BREAST, FROM_ZERO), 0, problem)
    estimates = {
        name: ParameterEstimate(
            f"{name}_kpa",
            "kPa",
            1e3 * low,
            1e3 * high,
            known.constants[name].estimate,
            None,
            limit=BREAST[name].door_limit,
            description=BREAST[name].description,
        )
        for name, (low, high) in FROM_ZERO.items()
    }
    return results(estimates=estimates, identification=known).judged


def test_tissue_without_fibres_has_a_stiffness_and_an_upper_limit_of_its_fibres() -> None:
    found = from_zero(without_fibres(eta_step=-0.5 * ETA_SD))
    fat, fibres = found.estimates["E_fat"], found.estimates["eta_fat"]
    assert fat.reasons == fibres.reasons == ()
    assert fibres.interval == pytest.approx((0.0, 1.6449 * 1e3 * ETA_SD))
    assert str(fibres) == "eta_fat < 11.51 kPa (90 %)"
    assert fibres.limit_note == "no fibre stiffness of fat and ligaments is needed"
    assert study_json(found)["identification"]["constants"]["eta_fat"]["identifiable"] == "limit"


def test_interval_beside_a_limit_extends_to_the_side_that_the_limit_allows() -> None:
    """More fibres make E_fat smaller; fewer than none cannot make it larger."""
    interval = from_zero(without_fibres(-0.5 * ETA_SD)).estimates["E_fat"].interval
    alone = 1.6449 * E_SD * math.sqrt(1 - SHARED**2)
    assert interval == pytest.approx((10 * math.exp(-1.6449 * E_SD), 10 * math.exp(alone)))


@pytest.mark.parametrize("shared", [-0.99, -0.8, -0.5, 0.2, 0.9])
def test_intervals_beside_a_limit_contain_nine_truths_of_ten(shared: float) -> None:
    """Truths drawn from the normal distribution, cut off at the limit."""
    covariance = np.array([[1.0, shared], [shared, 1.0]])
    lowest = np.array([-np.inf, 0.0])
    down, up = limited_reach(np.array([1.0, 0.0]), 1.0, covariance, lowest)
    draws = np.random.default_rng(3).multivariate_normal([0.0, 0.0], covariance, 100_000)
    truths = draws[draws[:, 1] >= 0, 0]
    assert 0.88 < np.mean((-down <= truths) & (truths <= up)) < 0.92


def test_an_unfinished_search_at_a_limit_is_not_quoted() -> None:
    """The sum of squares falls when fibres are added: the search has stopped too early."""
    found = from_zero(without_fibres(eta_step=5 * ETA_SD))
    assert "the search has not converged" in found.estimates["E_fat"].reasons
    assert found.estimates["E_fat"].interval is None


def test_fibres_that_the_image_requires_are_a_value_even_near_the_limit() -> None:
    """0.9 kPa with a standard deviation of 0.07 kPa, at 1 % of the searched interval."""
    problem = without_fibres(0.0, eta_mpa=0.0009)
    problem["hessian"][1][1] *= 1e4
    fibres = from_zero(problem).estimates["eta_fat"]
    assert fibres.quotable and not fibres.one_sided
    assert fibres.interval is not None and 0.7 < fibres.interval[0] < 0.9


def test_fibres_that_the_image_does_not_see_have_no_limit() -> None:
    problem = without_fibres(0.0)
    problem["hessian"] = [[1 / E_SD**2, 0.0], [0.0, 25.0]]  # a standard deviation of 200 kPa
    found = from_zero(problem)
    assert found.estimates["eta_fat"].reasons == ("no interval is known",)
    assert found.estimates["E_fat"].quotable


def test_a_lower_bound_above_the_limit_is_still_a_bound() -> None:
    limit = {"identifiable": "limit", "interval": (50.0, 60.0), "limit": 0.0}
    assert reasons(value=50.0, searched=(50.0, 200.0), **limit) == (
        "at the lower bound of the searched interval (50 kPa)",
    )
    assert reasons(value=0.0, searched=(0.0, 200.0), **limit | {"interval": (0.0, 12.0)}) == ()


@pytest.mark.parametrize("vocabulary", [BREAST, CORNEA], ids=["breast", "cornea"])
def test_every_parameter_that_may_be_zero_has_a_limit(vocabulary: Vocabulary) -> None:
    """A search from the limit cannot be widened, and one from elsewhere can."""
    for parameter in vocabulary:
        if parameter.limit is None:
            continue
        with pytest.raises(InputError, match="at least"):
            parameter.check_bounds((parameter.limit - 1e-6, parameter.upper))
        assert parameter.check(parameter.limit) == parameter.limit
    limited = {parameter.name for parameter in vocabulary if parameter.limit is not None}
    assert limited >= ({"eta_fat", "eta_muscle"} if vocabulary is BREAST else {"mu2", "iop_rise"})
    assert not limited & {"nu", "E_fat", "bulk", "eye_tilt"}


def test_scattered_candidates_at_a_limit_are_one_sided() -> None:
    best = {"E_fat": 0.01, "eta_fat": 0.0002}
    alike = [{"E_fat": 0.01 + 1e-4 * i, "eta_fat": 0.0002 + 1e-3 * i} for i in range(6)]
    searched = SearchedConstants(BREAST, FROM_ZERO)
    fibres = identification_from_scatter(searched, 0, best, alike, "").constants["eta_fat"]
    assert fibres.identifiable == "limit"
    assert fibres.interval is not None and fibres.interval.lower == 0.0


# --- errors other than the image -----------------------------------------------------------

PLACE = Nuisance("motion_x", "the place of the scan", 1.0, -5.0, 5.0)
FORCE = Nuisance("ln_plate_force", "the force", 0.08, -1.0, 1.0, always=True)


def with_nuisance(name: str, gradient: float, shared: float = 1000.0) -> FitJson:
    """Return the fit with a nuisance parameter that is correlated with E_fat."""
    hessian = [[1e4, 0.0, shared], [0.0, 400.0, 0.0], [shared, 0.0, 500.0]]
    parameters = [*BOUNDS, name]
    return fit(
        parameters=parameters,
        hessian=hessian,
        gradient=[0.0, 0.0, gradient],
        values=[0.01, 0.1, 0.0],
        logarithmic=[True, True, False],
    )


def test_a_misplaced_scan_contradicts_the_estimates() -> None:
    others = OtherProblems(with_nuisance("motion_x", -800.0), (PLACE,))
    found = identified(fit(), others)
    assert found.supported == ("the place of the scan",)
    # Its optimum is 800 / (500 - 100 + 1) = 2 mm, which moves E_fat by a fifth.
    assert found.constants["E_fat"].errors["the place of the scan"] == pytest.approx(2.0, rel=0.02)
    answer = studied(found).estimates["E_fat"]
    assert "the residual points to an error in the place of the scan" in answer.reasons


@pytest.mark.parametrize("squeezed", [True, False])
def test_a_collapsed_element_contradicts_all_estimates(squeezed: bool) -> None:
    best = results().best
    assert best is not None
    best = replace(best, outcome={**(best.outcome or {}), "squeezed": squeezed})
    again = studied(identified(fit()), best=best)
    clause = "its simulation squeezes an element to less than 0.3 of its volume"
    assert [clause in one.reasons for one in again.estimates.values()] == [squeezed] * 2
    assert (clause in again.squeezed_note) is squeezed


def test_correctly_placed_scan_does_not_change_intervals() -> None:
    others = OtherProblems(with_nuisance("motion_x", 0.0), (PLACE,))
    alone, beside = identified(fit()), identified(fit(), others)
    assert beside.supported == ()
    one, other = (found.constants["E_fat"].interval for found in (alone, beside))
    assert one is not None
    assert other is not None
    assert other.upper / one.upper < 1.01


def test_force_error_is_always_included() -> None:
    """A force that is 8 % too high gives a stiffness that is 8 % too high, at any residual."""
    with_force = with_nuisance("ln_plate_force", 0.0, -1e4)
    with_force["hessian"][2][2] = 1e4  # the same change in the residuals: not identifiable
    found = identified(fit(), OtherProblems(with_force, (FORCE,)))
    assert found.constants["E_fat"].errors["the force"] == pytest.approx(0.8, rel=1e-3)
    assert studied(found).estimates["E_fat"].quotable


def test_an_interval_contains_the_error_of_the_mesh() -> None:
    """On another mesh the optimum is 3 % higher, which is the possible error of the study."""
    mesh = fit(gradient=(-300.0, 0.0))
    others = OtherProblems(meshes=[{"nodes": 6000, "fit": mesh}])
    constant = identified(fit(), others).constants["E_fat"]
    assert constant.errors[MESH] == pytest.approx(0.1 * math.sqrt((9 + 4.5) / 2))
    assert constant.interval is not None
    assert constant.interval.lower < 9.7
    assert constant.interval.upper > 10.3
    assert in_words(constant.errors, 10.0) == "mesh 2.6 %, image 1 %"


def test_decisive_evidence_needs_a_large_gradient() -> None:
    gains = []
    for gradient in (0.0, 400.0, 800.0):
        others = OtherProblems(with_nuisance("motion_x", gradient), (PLACE,))
        gains.append(identified(fit(), others).supported != ())
    assert gains == [False, True, True]
    assert math.exp(DECISIVE) > 100


# --- a cornea ------------------------------------------------------------------------------


def eye(g0_bound: float, mu2_bound: float, not_measured: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "shear_modulus_mpa": 0.05,
        "shear_modulus_bounds": {"pixels": 0.01, "model": g0_bound},
        "bounds": {"model": {"mu2_mpa": mu2_bound, "alpha2": 0.2}},
        "noises": {"model": "10 µm, correlated over 0.5 mm"},
        "not_measured": list(not_measured),
    }


def test_undetermined_constant_of_a_cornea_is_not_quotable() -> None:
    found = identified(fit())
    said = against(eye(0.1, 0.9))
    assert said["alpha2"] == []
    shown = studied(found, findings={"against": {"E_fat": said["mu2"]}})
    assert shown.estimates["E_fat"].reasons == (
        "errors of model and image of 10 µm, correlated over 0.5 mm leave it uncertain by more "
        "than half",
    )
    assert shown.estimates["eta_fat"].quotable


def with_shear_modulus(**more: Any) -> StudyResults:
    """Return a study with a G0 proportional to E_fat, which is known to 1 %."""
    g0 = {"name": "G0", "value": 50.0, "unit": "kPa", "slope": {"E_fat": 1.0}, "against": []}
    found = [g0 | {"mesh_shift": None, "mesh_sd": None} | more]
    known = identification_from_tangents(SearchedConstants(BREAST, BOUNDS), 0, fit(), None, found)
    return studied(known, findings={"derived": found})


def test_the_shear_modulus_of_a_cornea_has_an_interval() -> None:
    shown = with_shear_modulus()
    (g0,) = derived_estimates(shown)
    assert g0.interval == pytest.approx((50 * math.exp(-0.016449), 50 * math.exp(0.016449)))
    assert derived_text(g0) == "G0: 50 kPa (49.18 to 50.83, 90 %). Quotable."
    assert study_json(shown)["derived"]["G0"]["quotable"] is True


def test_shear_modulus_interval_includes_the_mesh_error() -> None:
    """The mesh raises G0 by 3 %, with a standard deviation of a quarter of that."""
    (g0,) = derived_estimates(with_shear_modulus(mesh_shift=0.03, mesh_sd=0.0075))
    reach = 1.6449 * math.hypot(0.01, 0.0075)
    assert g0.interval == pytest.approx((50 * math.exp(-0.03 - reach), 50 * math.exp(reach)))


def test_the_shear_modulus_under_an_assumed_pressure_is_not_quotable() -> None:
    numbers = eye(0.1, 0.9, ("iop",)) | {"attained_stretches": [0.98, 1.04]}
    numbers["constants"] = {"mu1_mpa": 0.01, "alpha1": 30.0}
    (g0, *_) = derived(numbers, CorneaConstants((0.01,), (30.0,)))
    (shown, *_) = derived_estimates(with_shear_modulus(against=g0["against"]))
    assert shown.answer.reasons == ("the pressure of the eye is assumed, not measured",)


# --- a diagnosis ---------------------------------------------------------------------------


def diagnosed(**constant: Any) -> Summary:
    from tests.service.report.diagnosis_at_hand import VERDICTS

    told = VERDICTS["no gap"]
    own = {"before": 25.0, "after": None, "before_interval": [24.0, 26.0], "stated": [20.0, 50.0]}
    return from_json(Summary, told | {"constants": {"E_gl_kpa": own | constant}})


def test_a_constant_of_a_diagnosis_is_shown_with_its_interval() -> None:
    found = judged_constants(diagnosed())["E_gl_kpa"]
    assert found.answer.quotable
    assert found.text == "25 (24 to 26) kPa"


def test_a_constant_outside_its_stated_interval_is_not_quotable() -> None:
    summary = diagnosed(before=5.06, before_interval=[4.9, 5.2])
    record = summary_json(summary)["constants"]["E_gl_kpa"]
    assert record["quotable"] is False
    assert record["reasons"] == ["outside its stated interval (20 to 50 kPa)"]


def test_a_fit_that_has_not_converged_withholds_the_interval_of_a_diagnosis() -> None:
    found = judged_constants(diagnosed(converged=False))["E_gl_kpa"]
    assert found.interval is None
    assert found.answer.reasons == ("the search has not converged",)


def test_a_constant_of_a_law_that_stiffens_is_not_quotable() -> None:
    from tests.service.report.diagnosis_at_hand import VERDICTS

    own = {"before": 9.0, "after": 13.6, "after_interval": [12.3, 14.6], "depends_on_law": True}
    record = VERDICTS["effect"] | {"constants": {"E_fat_kpa": own}}
    found = judged_constants(from_json(Summary, record))["E_fat_kpa"]
    reason = "the slope at small strain depends on the law of the stiffening tissue"
    assert found.answer.reasons == (reason,)


def test_a_diagnosis_that_fits_no_better_than_the_body_at_rest_has_no_estimate() -> None:
    summary = diagnosed()
    for fitted_mm, estimated in ((2.5, True), (4.0, False)):
        gap = replace(summary.gap_mm, fitted_mm=fitted_mm, undeformed_mm=4.0)
        worse = replace(summary, gap_mm=gap)
        found = judged_constants(worse)["E_gl_kpa"]
        assert found.answer.quotable is estimated
        assert (found.text == "no estimate") is not estimated
        shown = [row.before for row in constant_table(worse)]
        assert (shown == [NONE]) is not estimated
    reason = "the best fit is no better than the undeformed body"
    assert found.answer.reasons == (reason,)
    assert summary_json(worse)["constants"]["E_gl_kpa"]["reasons"] == [reason]


def test_intervals_cover_the_truth_of_linear_problems_with_a_hidden_force() -> None:
    """With a force error of 8 %, 90 % of the intervals contain the true stiffness."""
    rng = np.random.default_rng(1)
    held = 0
    draws = 400
    for _ in range(draws):
        off = float(rng.normal(0.0, 0.08) + rng.normal(0.0, 0.01))
        problem = with_nuisance("ln_plate_force", 0.0, -1e4)
        problem["hessian"][2][2] = 1e4
        interval = identified(fit(), OtherProblems(problem, (FORCE,))).constants["E_fat"].interval
        assert interval is not None
        held += interval.lower <= 10.0 * math.exp(off) <= interval.upper
    assert 0.86 < held / draws < 0.94
