"""True magnitudes as catalogue parameters, and the expected answer for each truth."""

import math
from math import sqrt
from typing import Any

import pytest

from palpate.service.blind.case_truth import Truth
from palpate.service.blind.set_scoring import lump_apart_mm, magnitudes, true_values
from palpate.workers.blind.random_case import KINDS, draw
from palpate.workers.diagnosis.outcome.diagnosis_summary import EffectSummary, ParameterEstimate
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS

GROUP_OF = {
    "control": "control",
    "pair": "pair",
    "triple": "triple",
    "plate_force": "absorbed",
    "wall_rise": "unlike",
    "bent_plate": "relative",
    "ligament": "relative",
    "oedema": "relative",
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_uses_catalogue_names(kind: str) -> None:
    truth = Truth.model_validate(draw(11, kind).record())
    known = {e.name: e for e in BREAST_EFFECTS}
    assert truth.group == GROUP_OF.get(kind, "single")
    assert set(truth.families) <= {e.family for e in BREAST_EFFECTS}
    assert set(true_values(truth)) <= {
        p.door_name for n in truth.effects for p in known[n].parameters
    }
    for cause in truth.causes:
        if cause.effect is not None:
            assert cause.family == known[cause.effect].family
            assert known[cause.effect].truth is not None


def said(name: str, **sizes: float) -> dict[str, EffectSummary]:
    rows = tuple(ParameterEstimate(n, m, 0.1, "") for n, m in sizes.items())
    lead = rows[0]
    effect = EffectSummary(
        name=name,
        family="",
        summary="",
        gain=40.0,
        magnitude=lead.magnitude,
        sd=lead.sd,
        unit=lead.unit,
        parameters=rows,
        log_bayes_factor=0.0,
        absorbed_share=0.0,
        refitted=True,
    )
    return {name: effect}


def test_fibre_directions_are_compared_as_two_rotations() -> None:
    turned = {
        "kind": "fibres",
        "effect": "fibre_rotation",
        "family": "global material",
        "parameters": {"turn_deg": 20.0, "azimuth_deg": 150.0, "fan_deg": 3.0},
    }
    truth = Truth.model_validate({"kind": "fibres", "causes": [turned]})
    found = magnitudes(truth, said("fibre_rotation", fibre_turn_x_deg=-17.0, fibre_turn_y_deg=9.0))
    assert [m.true for m in found] == pytest.approx([-10 * sqrt(3), 10])
    assert [m.found for m in found] == [-17.0, 9.0]
    assert magnitudes(truth, {}) == []


def made_before(kind: str, family: str | None, parameters: dict[str, Any]) -> Truth:
    """Return a truth of a sealed set in which this cause had no effect in the catalogue."""
    cause = {"kind": kind, "effect": None, "family": family, "parameters": parameters}
    return Truth.model_validate({"seed": 1, "kind": kind, "causes": [cause]})


def test_truths_of_old_sets_are_not_reinterpreted() -> None:
    given = {"volume_fraction": 0.1, "whole_gland": True, "centre_mm": [0, 0, 20], "radius_mm": 15}
    swelling = made_before("swelling", None, given)
    assert (swelling.group, swelling.effects) == ("unlike", ())
    grip = {"x_mm": 0.0, "y_mm": 0.0, "radius_mm": 20.0, "grip_kpa_per_mm": 3.0}
    adhesion = made_before("adhesion", "boundary", grip)
    assert (adhesion.group, adhesion.families) == ("relative", ("boundary",))
    for truth in (swelling, adhesion):
        assert true_values(truth) == {}
        assert magnitudes(truth, {}) == []


def test_new_causes_are_converted_to_catalogue_parameters() -> None:
    def true(kind: str, **parameters: Any) -> dict[str, float]:
        record = draw(3, kind).record()
        record["causes"][0]["parameters"] |= parameters
        return true_values(Truth.model_validate(record))

    swollen = {"ln_growth_fat": 0.0, "ln_growth_glandular": pytest.approx(math.log(1.1))}
    assert true("swelling", volume_fraction=0.1) == swollen
    assert true("short_plate", edge_mm=5.0) == {"plate_edge_mm": 5.5}
    assert true("fibre_contrast", ratio=0.5) == {"ln_fibre_contrast": pytest.approx(-math.log(2))}
    scales = {"scale_x": 0.0, "scale_y": -0.01, "scale_z": 0.0}
    assert true("image_scale", scale=[0.0, -0.01, 0.0]) == scales
    springs = {f"attachment_stiffness_{axis}_kpa_per_mm": 0.2 for axis in "xyz"}
    assert true("tether", grip_kpa_per_mm=0.2) == springs
    # A disc of radius R has area pi R^2, a bell of radius r has 2 pi r^2.
    assert true("adhesion", grip_kpa_per_mm=2.0, radius_mm=20.0) == {
        "attachment_stiffness_x_kpa_per_mm": 2.0,
        "attachment_stiffness_y_kpa_per_mm": 2.0,
        "attachment_radius_mm": pytest.approx(math.sqrt(200.0)),
    }


def test_distance_of_a_lump_is_between_scan_coordinates() -> None:
    truth = Truth.model_validate(draw(5, "inclusion").record())
    at = truth.causes[0].parameters["centre_mm"]
    shifted = {f"inclusion_position_{axis}_mm": at[n] + 2.0 for n, axis in enumerate("xyz")}
    found = said("inclusion", **shifted)
    assert lump_apart_mm(truth, found) == pytest.approx(math.sqrt(12.0))
    assert lump_apart_mm(truth, {}) is None
