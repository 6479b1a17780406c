"""Metrics of handmade answers, against values calculated by hand."""

from math import sqrt
from typing import Any

import numpy as np
import pytest

from palpate.service.blind.answer_statistics import confusion, mean, median, reliability, share
from palpate.service.blind.blind_metrics import Metric, floor_mm, metrics, regrouped, visible
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
    "gain": 3.0,
    "claimed_after_mm": None,
    "true_after_mm": None,
    "claimed_share": None,
    "held_out_share": None,
}
WRONG: dict[str, Any] = {"primary": ("plate_friction",)}
UNSURE: dict[str, Any] = {
    "answer": "cannot-be-told-apart",
    "primary": ("plate_friction",),
    "rivals": ("plate_friction", "plate_tilt"),
    "gain": 12.0,
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


# Metrics


def hidden_force(**changes: Any) -> CaseRecord:
    return nothing("absorbed", effects=("plate_force",), families=("loading",), **changes)


def test_false_alarms_count_controls_and_hidden_effects() -> None:
    outside = nothing(answer="none-of-these", something_else=True)
    named = nothing(answer="effect", primary=("plate_tilt",), gain=8.0)
    hidden, unsure = hidden_force(), hidden_force(**UNSURE)
    missed = record(**MISSED)
    found = scored(nothing(), nothing(), outside, named, hidden, hidden, hidden, unsure, missed)
    assert value(found, "false_alarms") == (3 / 8, 8)
    assert found["false_alarms"].met is False
    assert scored(nothing())["false_alarms"].met is True


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
    unsure = record(**UNSURE)
    named = nothing(answer="effect", primary=("plate_tilt",))
    found = scored(record(), record(), record(), record(**WRONG), unsure, named)
    assert value(found, "named_right") == (0.6, 5)
    assert value(found, "complete") == (0.6, 5)
    more = record(primary=("plate_tilt", "plate_friction"))
    two = ("plate_tilt", "plate_friction")
    fewer, both = record("pair", effects=two), record("pair", effects=two, primary=two[::-1])
    found = scored(record(), more, fewer, both, record("relative", effects=()))
    assert value(found, "named_right") == (1.0, 5)
    assert value(found, "complete") == (0.5, 4)  # a relative has no name in the catalogue


def test_effects_that_cannot_be_told_apart_are_counted_beside() -> None:
    """Of four visible effects two are named first, and another is among the rivals."""
    apart = record(**UNSURE | {"rivals": ("plate_friction", "inclusion")})
    second = record(primary=("plate_friction", "plate_tilt"))
    first = record(**UNSURE | {"primary": ("plate_tilt",)})
    found = scored(record(), record(**UNSURE), apart, first)
    assert value(found, "first_visible") == (0.5, 4)
    assert value(found, "among_visible") == (0.75, 4)
    assert value(scored(second), "among_visible") == (1.0, 1)


def test_reliability_counts_first_causes_by_their_gain() -> None:
    """Bands of 10 to 20, 20 to 50 and above 50 nats; a limit belongs to the band below it."""
    cases = [
        record(gain=12.5),
        record(gain=20.0, **WRONG),
        record(**UNSURE),
        record(**UNSURE | {"rivals": ("plate_friction", "inclusion")}),
        record(gain=20.1),
        record("pair", gain=49.0, effects=("growth", "plate_tilt")),
        record("relative", gain=50.0, effects=(), families=("boundary",)),
        record("relative", gain=51.0, effects=()),
        nothing(answer="effect", primary=("plate_tilt",), gain=300.0),
        record(**MISSED),
        nothing("unlike", kind="swelling", answer="none-of-these", gain=30.0),
        CaseRecord("x", "tilt", "single", ("plate_tilt",), ("plate geometry",), "failed"),
    ]
    bands = reliability(cases)
    assert [(b.above, b.up_to) for b in bands] == [(10.0, 20.0), (20.0, 50.0), (50.0, None)]
    assert [(b.named.value, b.named.count) for b in bands] == [(0.5, 2), (2 / 3, 3), (0.5, 2)]
    assert [(b.unsure.value, b.unsure.count) for b in bands] == [(0.5, 2), (None, 0), (None, 0)]
    assert (bands[1].named.low, bands[1].named.high) == pytest.approx((0.2077, 0.9385), abs=5e-5)


def test_faint_cases_are_scored_separately() -> None:
    # The floor is the median control, 0.10 mm; visible is above 0.15 mm.
    controls = [nothing(true_before_mm=g) for g in (0.05, 0.10, 0.40)]
    faint = [record(true_before_mm=0.15, **MISSED), record(true_before_mm=0.12)]
    seen = [record(true_before_mm=g) for g in (0.16, 0.29, 0.31)]
    missed = record(true_before_mm=0.5, **MISSED)
    cases = [*controls, *faint, *seen, missed]
    assert floor_mm(cases) == 0.10
    found = scored(*cases)
    assert value(found, "first_visible") == (0.75, 4)
    assert found["first_visible"].met is False
    assert value(found, "among_visible") == (0.75, 4)


def test_without_a_floor_all_gaps_are_visible() -> None:
    assert visible(record(true_before_mm=0.001), None)


def test_causes_outside_the_catalogue_have_their_own_metrics() -> None:
    def unlike(answer: str, gap: float, **more: Any) -> CaseRecord:
        return nothing("unlike", kind="swelling", answer=answer, true_before_mm=gap, **more)

    also = unlike("effect", 0.3, primary=("plate_tilt",), something_else=True)
    relative = record("relative", kind="bent_plate", effects=())
    doubted = record("relative", kind="bent_plate", effects=(), something_else=True)
    strange = record("relative", kind="bent_plate", effects=(), **WRONG)
    found = scored(
        nothing(),
        unlike("none-of-these", 0.3),
        also,
        unlike("effect", 0.3, primary=("plate_tilt",)),
        unlike("cannot-be-told-apart", 0.3, primary=("plate_tilt",)),
        unlike("no-gap", 0.3),
        unlike("none-of-these", 0.1),
        relative,
        doubted,
        strange,
    )
    assert value(found, "unlike_visible") == (2 / 5, 5)
    assert value(found, "relatives_outside") == (1 / 3, 3)
    assert value(found, "relatives") == (2 / 3, 3)
    assert (also.right, relative.right, strange.right) == (True, True, False)


def test_pairs_are_scored_by_the_first_and_by_all_named_effects() -> None:
    two = {"effects": ("plate_tilt", "plate_friction"), "families": ("plate geometry", "boundary")}
    first = record("pair", **two)
    both = record("pair", **two, primary=("plate_friction", "plate_tilt"))
    more = record("pair", **two, primary=("plate_friction", "plate_tilt", "inclusion"))
    other = record("pair", **two, primary=("inclusion",))
    found = scored(first, both, more, other)
    assert value(found, "pairs_first") == (3 / 4, 4)
    assert value(found, "pairs_complete") == (1 / 4, 4)
    assert found["pairs_complete"].met is False


def test_triples_are_scored_by_the_first_and_by_all_named_effects() -> None:
    """Of four diagnoses, three name a true effect first, and one names all three."""
    three = {
        "effects": ("plate_tilt", "growth", "plate_friction"),
        "families": ("plate geometry", "growth", "boundary"),
    }
    one = record("triple", **three)
    whole = record("triple", **three, primary=("growth", "plate_tilt", "plate_friction"))
    more = record("triple", **three, primary=("inclusion", "growth", "plate_friction"))
    other = record("triple", **three, primary=("plate_friction", "inclusion"))
    found = scored(one, whole, more, other)
    assert value(found, "triples_first") == (0.75, 4)
    assert value(found, "triples_complete") == (0.25, 4)
    assert value(found, "pairs_complete") == (None, 0)
    assert [r.right for r in (one, whole, more, other)] == [True, True, False, True]
    controls = [nothing(true_before_mm=0.10)]
    faint = record("triple", **three, true_before_mm=0.12)
    assert value(scored(*controls, faint, whole), "triples_complete") == (1.0, 1)
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


def test_baselines_with_a_threshold_have_as_many_false_alarms_as_the_diagnosis() -> None:
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
    silent = CaseRecord("y", "control", "control", (), (), "failed")
    assert value(scored(silent), "false_alarms") == (1.0, 1)
    assert not silent.right


def test_confusion_counts_every_case_once() -> None:
    odd = nothing("unlike", kind="swelling", answer="none-of-these")
    alarm = nothing(answer="none-of-these")
    cases = [nothing(), alarm, record(), record(**WRONG), record(**MISSED), odd]
    found = confusion(cases)
    assert found.rows == ("control", "plate_tilt", "swelling")
    assert found.columns == ("no-gap", "plate_tilt", "plate_friction", "none-of-these")
    assert found.counts == ((1, 0, 0, 1), (1, 1, 1, 0), (0, 0, 0, 1))
    assert found.right == {(0, 0), (1, 1), (2, 3)}


def test_a_cell_of_the_confusion_is_right_only_if_all_its_cases_are() -> None:
    named: dict[str, Any] = {"kind": "swelling", "answer": "effect", "primary": ("plate_tilt",)}
    also = nothing("unlike", **named, something_else=True)
    assert confusion([also]).right == {(0, 1)}
    assert confusion([also, nothing("unlike", **named)]).right == set()


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
