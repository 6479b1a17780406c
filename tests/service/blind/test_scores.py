"""Metrics of handmade answers, against values calculated by hand."""

import math
from math import sqrt
from typing import Any

import numpy as np
import pytest

from palpate.service.blind.answer_statistics import (
    brier,
    brier_of_base_rates,
    calibration_curve,
    calibration_error,
    confusion,
    correlation,
    log_score,
    mean,
    median,
    share,
    statements,
    sure_statements,
)
from palpate.service.blind.blind_metrics import (
    Metric,
    floor_mm,
    metrics,
    regrouped,
    strata,
    visible,
)
from palpate.service.blind.case_truth import CaseRecord, Magnitude
from palpate.service.blind.set_answering import (
    baseline_threshold,
    closest_refit,
    largest_correlation,
    raw_correlation,
    refit_improvement,
)
from tests.service.blind.blind_at_hand import nothing, record


def scored(*records: CaseRecord) -> dict[str, Metric]:
    found = metrics(records)
    assert len({f.key for f in found}) == len(found)
    return {f.key: f for f in found}


def value(found: dict[str, Metric], key: str) -> tuple[float | None, int]:
    return found[key].estimate.value, found[key].estimate.count


MISSED: dict[str, Any] = {
    "answer": "no-gap",
    "primary": (),
    "primary_families": (),
    "set90": ("no-gap",),
    "claimed_after_mm": None,
    "true_after_mm": None,
    "claimed_share": None,
    "held_out_share": None,
}
WRONG: dict[str, Any] = {
    "primary": ("plate_friction",),
    "primary_families": ("boundary",),
    "set90": ("plate_friction", "plate_tilt"),
}


# Intervals


def test_wilson_interval_matches_published_values() -> None:
    # R. G. Newcombe, Stat. Med. 17 (1998) 857, table I: 81 of 263 gives 0.2553 to 0.3662.
    found = share([True] * 81 + [False] * 182)
    assert (found.low, found.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    # ... and 0 of 20 gives 0 to 0.1611.
    none = share([False] * 20)
    assert (none.low, none.high) == (0.0, pytest.approx(0.1611, abs=5e-5))
    assert share([]).value is None


def test_bootstrap_interval_has_its_nominal_coverage() -> None:
    rng = np.random.default_rng(1)
    found = [mean(rng.normal(2.0, 1.0, 40).tolist()) for _ in range(200)]
    held = np.mean([f.low < 2.0 < f.high for f in found])  # type: ignore[operator]
    assert 0.89 < held < 0.98
    widths = [f.high - f.low for f in found]  # type: ignore[operator]
    assert np.mean(widths) == pytest.approx(2 * 1.96 / sqrt(40), rel=0.06)
    assert median([1.0, 2.0, 30.0]).value == 2.0


def test_correlation_equals_pearsons_coefficient() -> None:
    found = correlation([0, 1, 2, 3], [0, 1, 4, 9])
    assert found.value == pytest.approx(15 / sqrt(5 * 49))
    assert correlation([1, 2], [1, 2]).value is None
    assert correlation([1, 1, 1], [1, 2, 3]).value is None


# Metrics


def test_false_alarms_count_controls_and_hidden_effects() -> None:
    alarm = nothing(answer="none-of-these", set90=("none-of-these",))
    hidden = nothing("absorbed", effects=("plate_force",), families=("loading",))
    found = scored(nothing(), nothing(), alarm, hidden, record(**MISSED))
    assert value(found, "false_alarms") == (0.25, 4)
    assert found["false_alarms"].met is False
    assert scored(nothing())["false_alarms"].met is True


def test_counts_sure_false_alarms_separately() -> None:
    doubted = nothing(answer="none-of-these", probabilities={"none-of-these": 0.6, "no-gap": 0.3})
    sure = nothing(answer="none-of-these", probabilities={"none-of-these": 0.95, "no-gap": 0.03})
    named = nothing(answer="effect", primary=("plate_tilt",), probabilities={"plate_tilt": 0.92})
    found = scored(nothing(), doubted, sure, named)
    assert value(found, "false_alarms") == (0.75, 4)
    assert value(found, "sure_alarms") == (0.5, 4)


def test_hidden_effect_with_a_visible_gap_should_be_named() -> None:
    force = {"effects": ("plate_force",), "families": ("loading",)}
    controls = [nothing(true_before_mm=0.10)]
    faint = nothing("absorbed", **force, true_before_mm=0.15)
    unknown = nothing("absorbed", **force, true_before_mm=None)
    named = record(group="absorbed", **force, primary=("plate_force",), true_before_mm=0.16)
    groups = [r.group for r in regrouped([*controls, faint, unknown, named])]
    assert groups == ["control", "absorbed", "absorbed", "single"]
    assert [r.group for r in regrouped([faint, named])] == ["absorbed", "absorbed"]
    found = {f.key: f for f in metrics(regrouped([*controls, faint, unknown, named]))}
    assert value(found, "false_alarms") == (0.0, 3)
    assert value(found, "first_visible") == (1.0, 1)


def test_counts_named_effects_that_act() -> None:
    unsure = record(answer="cannot-be-told-apart", **WRONG)
    named = nothing(answer="effect", primary=("plate_tilt",), primary_families=("plate geometry",))
    found = scored(record(), record(), record(), record(**WRONG), unsure, named)
    assert value(found, "named_right") == (0.6, 5)
    assert value(found, "unsure_right") == (0.0, 1)
    both = record(primary=("plate_tilt", "plate_friction"))
    found = scored(record(), both)
    assert value(found, "named_right") == (1.0, 2)
    assert value(found, "strict") == (0.5, 2)


def test_faint_cases_are_scored_separately() -> None:
    # The floor is the median control, 0.10 mm; visible is above 0.15 mm, clear above 0.30 mm.
    controls = [nothing(true_before_mm=g) for g in (0.05, 0.10, 0.40)]
    faint = [record(true_before_mm=0.15, **MISSED), record(true_before_mm=0.12)]
    seen = [record(true_before_mm=g) for g in (0.16, 0.29, 0.31)]
    missed = record(true_before_mm=0.5, **MISSED)
    cases = [*controls, *faint, *seen, missed]
    assert floor_mm(cases) == 0.10
    found = scored(*cases)
    assert value(found, "first_visible") == (0.75, 4)
    assert found["first_visible"].met is False
    shares = [value(found, f"first_{key}") for key in ("faint", "middling", "clear")]
    assert shares == [(0.5, 2), (1.0, 2), (0.5, 2)]
    assert value(found, "covered") == (4 / 6, 6)
    assert value(found, "covered_visible") == (0.75, 4)
    assert [len(chosen) for _, _, chosen in strata([record()], None)] == []


def test_weak_effects_are_scored_separately() -> None:
    weak = [record(strength=0.5, **MISSED), record(strength=3.9)]
    strong = [record(strength=s) for s in (4.0, 7.0)]
    found = scored(nothing(true_before_mm=0.1), *weak, *strong, record(**MISSED))
    assert value(found, "first_weak") == (0.5, 2)
    assert value(found, "first_strong") == (1.0, 2)


def test_without_a_floor_all_gaps_are_visible() -> None:
    assert visible(record(true_before_mm=0.001), None)


def test_causes_outside_the_catalogue_have_their_own_metrics() -> None:
    def unlike(answer: str, gap: float) -> CaseRecord:
        return nothing("unlike", kind="swelling", answer=answer, true_before_mm=gap)

    relative = record("relative", kind="bent_plate", effects=())
    strange = record("relative", kind="bent_plate", effects=(), **WRONG)
    found = scored(
        nothing(),
        unlike("none-of-these", 0.3),
        unlike("effect", 0.3),
        unlike("cannot-be-told-apart", 0.3),
        unlike("no-gap", 0.3),
        unlike("no-gap", 0.1),
        relative,
        relative,
        strange,
    )
    assert value(found, "unlike_visible") == (1 / 4, 4)
    assert value(found, "unlike_careful") == (2 / 4, 4)
    assert value(found, "unlike") == (1 / 5, 5)
    assert value(found, "relatives") == (2 / 3, 3)
    assert relative.right
    assert not relative.covered  # no cause in the catalogue is true


def test_pairs_are_scored_by_the_first_and_by_both_named_effects() -> None:
    two = {"effects": ("plate_tilt", "plate_friction"), "families": ("plate geometry", "boundary")}
    first = record("pair", **two)
    both = record("pair", **two, primary=("plate_friction", "plate_tilt"))
    other = record("pair", **two, primary=("inclusion",), primary_families=("local stiffness",))
    found = scored(first, both, other)
    assert value(found, "pairs_first") == (2 / 3, 3)
    assert value(found, "pairs_both") == (1 / 3, 3)


def test_triples_are_scored_by_the_first_and_by_two_named_effects() -> None:
    """Of four diagnoses, three name a true effect first, and two name two true effects."""
    three = {
        "effects": ("plate_tilt", "growth", "plate_friction"),
        "families": ("plate geometry", "growth", "boundary"),
    }
    one = record("triple", **three)
    two = record("triple", **three, primary=("growth", "plate_tilt"))
    more = record("triple", **three, primary=("inclusion", "growth", "plate_friction"))
    other = record("triple", **three, primary=("plate_friction", "inclusion"))
    found = scored(one, two, more, other)
    assert value(found, "triples_first") == (0.75, 4)
    assert value(found, "triples_two") == (0.5, 4)
    assert found["triples_two"].met
    assert value(found, "strict") == (0.5, 4)
    assert value(found, "pairs_both") == (None, 0)
    assert [r.right for r in (one, two, more, other)] == [True, True, False, True]
    controls = [nothing(true_before_mm=0.10)]
    faint = record("triple", **three, true_before_mm=0.12)
    assert value(scored(*controls, faint, two), "triples_two") == (1.0, 1)
    rows = confusion([one, *controls]).rows
    assert rows == ("control", "plate_tilt + growth + plate_friction")


def test_errors_of_gaps_and_shrinkage_match_hand_calculation() -> None:
    # True shrinkage 1 - 0.1^2 / 0.2^2 = 0.75 and 1 - 0.3^2 / 0.4^2 = 0.4375.
    a = record(
        true_before_mm=0.2,
        true_after_mm=0.1,
        claimed_before_mm=0.23,
        claimed_after_mm=0.1,
        claimed_share=0.95,
        held_out_share=0.70,
    )
    b = record(
        true_before_mm=0.4,
        true_after_mm=0.3,
        claimed_before_mm=0.35,
        claimed_after_mm=0.2,
        claimed_share=0.6,
        held_out_share=0.5,
    )
    found = scored(a, b, record(**MISSED, true_before_mm=0.3, claimed_before_mm=0.3))
    assert value(found, "gap_error") == (pytest.approx(0.08 / 3), 3)
    assert value(found, "gap_error_part") == (pytest.approx((0.15 + 0.125) / 3), 3)
    assert value(found, "gap_after_error") == (pytest.approx(0.05), 2)
    held, inside = (
        value(found, "shrinkage_error_held_out"),
        value(found, "shrinkage_error_claimed"),
    )
    assert held == (pytest.approx((0.05 + 0.0625) / 2), 2)
    assert inside == (pytest.approx((0.2 + 0.1625) / 2), 2)
    assert found["shrinkage_error_held_out"].met
    assert found["gap_error"].met


def test_counts_intervals_that_cover_the_truth() -> None:
    # True gap 0.30 mm, true shrinkage 8/9.
    inside = record(gap_interval_mm=(0.2, 0.4), share_interval=(0.8, 1.0))
    outside = record(gap_interval_mm=(0.31, 0.4), share_interval=(0.9, 1.0))
    found = scored(inside, outside, outside, record())
    assert value(found, "gap_within") == (1 / 3, 3)
    assert value(found, "shrinkage_within") == (1 / 3, 3)


def test_large_gaps_have_a_relative_tolerance() -> None:
    off = record(true_before_mm=1.0, claimed_before_mm=0.8)
    assert scored(off)["gap_error"].met
    assert not scored(record(true_before_mm=0.2, claimed_before_mm=0.3))["gap_error"].met


def test_magnitudes_count_only_for_correct_causes() -> None:
    sizes = (Magnitude("a", 5.0, 0.5, 4.0), Magnitude("b", 0.1, 0.1, 0.0))
    found = scored(record(magnitudes=sizes), record(**WRONG | {"magnitudes": sizes}))
    assert value(found, "magnitude_sds") == (1.5, 2)
    assert value(found, "magnitude_within") == (1.0, 2)
    assert value(found, "magnitude_part") == (0.25, 1)
    lump = {"effects": ("inclusion",), "primary": ("inclusion",)}
    near = scored(
        record(lump_apart_mm=2.0, **lump),
        record(lump_apart_mm=5.0, **lump),
        record(lump_apart_mm=20.0, answer="no-gap", primary=()),
    )
    assert value(near, "lump") == (3.5, 2)
    assert near["lump"].met is False
    assert value(near, "lump_unnamed") == (20.0, 1)


def test_baselines_always_name_an_effect() -> None:
    raw = {"raw_correlation": "plate_tilt", "refit": "plate_friction"}
    found = scored(record(named_by=raw), record(named_by=raw | {"refit": "plate_tilt"}))
    assert value(found, "baseline_raw_correlation") == (1.0, 2)
    assert value(found, "baseline_refit") == (0.5, 2)
    assert value(found, "baseline_chance") == (0.5, 2)


def test_baselines_with_a_threshold_have_as_few_false_alarms_as_the_diagnosis() -> None:
    def body(group: str, loud: float, **more: object) -> CaseRecord:
        named = {"refit": "plate_tilt"}
        return record(group, named_by=named, loudness={"refit": loud}, **more)

    silent = [body("control", loud, answer="no-gap", effects=()) for loud in (0.1, 0.3, 0.2)]
    singles = [body("single", loud, true_before_mm=0.9) for loud in (0.25, 0.35, 0.9)]
    assert value(scored(*silent, *singles), "baseline_refit_silent") == (pytest.approx(2 / 3), 3)
    alarm = body("control", 0.15, answer="effect", effects=())
    assert value(scored(*silent, alarm, *singles), "baseline_refit_silent") == (1.0, 3)
    assert value(scored(*singles), "baseline_refit") == (1.0, 3)
    assert "baseline_refit_silent" not in scored(*singles)


def test_evidence_of_a_refit_is_its_reduction_of_the_residual() -> None:
    assert refit_improvement({"a": 0.5, "b": 0.25}, 0.5) == pytest.approx(np.log(2))
    assert refit_improvement({}, 0.5) == 0.0
    assert [baseline_threshold([3.0, 1.0, 2.0], alarms) for alarms in (0, 1)] == [3.0, 2.0]
    assert baseline_threshold([], 0) == -np.inf


def test_a_failed_diagnosis_is_a_wrong_answer() -> None:
    failed = CaseRecord("x", "tilt", "single", ("plate_tilt",), ("plate geometry",), "failed")
    found = scored(record(), failed)
    assert value(found, "first_visible") == (0.5, 2)
    assert value(found, "covered") == (0.5, 2)
    silent = CaseRecord("y", "control", "control", (), (), "failed")
    assert value(scored(silent), "false_alarms") == (1.0, 1)
    assert not silent.right


# Probabilities


def given(no_gap: float, none: float, tilt: float, friction: float) -> dict[str, float]:
    return {"no-gap": no_gap, "none-of-these": none, "plate_tilt": tilt, "plate_friction": friction}


def test_brier_score_matches_hand_calculation() -> None:
    sure = record(probabilities=given(0, 0, 1, 0))
    half = record(probabilities=given(0.5, 0, 0.5, 0))
    assert brier([sure]).value == 0
    assert brier([half]).value == 0.5
    assert brier([sure, half, record("relative", effects=())]).value == pytest.approx(0.5 / 3)
    # Half of the cases are controls: 0.25 each for "no gap" and for the tilt.
    assert brier_of_base_rates([sure, nothing()]).value == 0.5


def test_log_score_matches_hand_calculation() -> None:
    half = record(probabilities=given(0.5, 0, 0.5, 0))
    assert log_score([half]).value == pytest.approx(2 * math.log(2))
    wrong = record(probabilities=given(1, 0, 0, 0))  # each bounded at one in 10,000
    assert log_score([wrong]).value == pytest.approx(2 * math.log(1e4))


def test_expected_calibration_error_matches_hand_calculation() -> None:
    """Three statements of 80 %, one of which is true, and one of 0 that is false."""
    cases = [
        record(probabilities={"plate_tilt": 0.8, "no-gap": 0.0}),
        record(probabilities={"plate_friction": 0.8}),
        record(probabilities={"no-gap": 0.8}),
    ]
    expected = 3 / 4 * abs(0.8 - 1 / 3)
    assert calibration_error(cases).value == pytest.approx(expected)
    assert calibration_error([]).value is None


def test_statements_about_relatives_refer_to_families() -> None:
    bent = record(
        "relative",
        effects=(),
        families=("plate geometry",),
        probabilities=given(0.02, 0.03, 0.95, 0),
        family_probabilities={"plate geometry": 0.95, "boundary": 0.0},
    )
    made = [(0.95, True), (0.0, False), (0.02, False)]
    assert statements(bent) == made
    assert sure_statements([bent]).value == 1.0


def test_calibration_curve_groups_statements_by_probability() -> None:
    cases = [
        record(probabilities={"plate_tilt": 0.75}),
        record(probabilities={"no-gap": 0.71}),
        record(probabilities={"plate_tilt": 1.0, "no-gap": 0.0}),
    ]
    bins = calibration_curve(cases)
    assert [b.came_true.count for b in bins] == [1, 0, 0, 0, 0, 0, 0, 2, 0, 1]
    assert bins[7].said == pytest.approx(0.73)
    assert bins[7].came_true.value == 0.5
    assert bins[9].came_true.value == 1.0
    assert (bins[3].said, bins[3].came_true.value) == (None, None)


def test_confusion_counts_every_case_once() -> None:
    odd = nothing("unlike", kind="swelling", answer="none-of-these")
    alarm = nothing(answer="none-of-these")
    cases = [nothing(), alarm, record(), record(**WRONG), record(**MISSED), odd]
    found = confusion(cases)
    assert found.rows == ("control", "plate_tilt", "swelling")
    assert found.columns == ("no-gap", "plate_tilt", "plate_friction", "none-of-these")
    assert found.counts == ((1, 0, 0, 1), (1, 1, 1, 0), (0, 0, 0, 1))
    assert found.right == {(0, 0), (1, 1), (2, 3)}


# Baselines


def test_raw_correlation_is_the_largest_cosine_over_all_places() -> None:
    residual = np.array([1.0, 0.0, 0.0, 0.0])
    flat = np.array([[1.0, 0.0], [1.0, 5.0], [0.0, 0.0], [0.0, 0.0]])
    assert raw_correlation(flat, residual) == pytest.approx(sqrt(0.5))
    places = np.stack([flat, -2 * np.eye(4)[:, :2]])
    assert raw_correlation(places, residual) == pytest.approx(1.0)
    assert raw_correlation(np.zeros((4, 1)), residual) == 0.0
    assert largest_correlation({"a": 0.2, "b": 0.9}) == "b"
    assert closest_refit({"a": 0.2, "b": 0.9}) == "a"
    assert (largest_correlation({}), closest_refit({})) == (None, None)
