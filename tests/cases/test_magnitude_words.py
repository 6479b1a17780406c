"""Display of magnitudes: unit, 90 % interval and the value in the model, never a logarithm."""

import io
import math
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from palpate.service.commands.studies.diagnosing import print_verdict
from palpate.service.diagnosis.diagnosis_words import headline, power, seen_from
from palpate.service.diagnosis.magnitude_words import magnitude
from palpate.service.diagnosis.plan_words import planned_amounts
from palpate.service.number_formatting import number, share
from palpate.service.report.diagnosis import diagnosis_tables as tables
from palpate.service.report.diagnosis.diagnosis_tables import parameter_name
from palpate.storage.json_digests import from_json, to_json
from palpate.workers.diagnosis.outcome.diagnosis_summary import ParameterEstimate, Summary
from palpate.workers.diagnosis.plan_summary import ParameterPlan
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.model_parameters import (
    Parameter,
    ShownMagnitude,
    shown,
    shown_change,
)
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS, BREAST_MODEL
from palpate.workers.organs.cornea.cornea_effects import CORNEA_EFFECTS
from palpate.workers.organs.specimen.specimen_effects import specimen_effects
from tests.service.report.diagnosis_at_hand import VERDICTS, effect, parameter, summary

DOWN = (0.0, -1.0, 0.0)
EFFECTS: list[Effect] = [
    *BREAST_EFFECTS,
    *specimen_effects(DOWN, (0.0, 0.0, 0.0), None, True, True, True, True),
    *CORNEA_EFFECTS,
]
PARAMETERS = {p.name: p for e in EFFECTS for p in e.parameters}


def read(p: Parameter, value: float, sd: float, nu: float | None = 0.49) -> ShownMagnitude:
    neutral = p.unit.to_door(p.neutral or 0.0)
    return shown(p.reading, value, sd, neutral, p.unit.symbol, nu)


def text(name: str, value: float, sd: float, nu: float | None = 0.49) -> str:
    one = PARAMETERS[name]
    read_as = read(one, value, sd, nu)
    return magnitude(ParameterEstimate(one.door_name, value, sd, one.unit.symbol, read_as))


@pytest.mark.parametrize(
    ("name", "value", "sd", "expected"),
    [
        ("gravity_z", 0.75, 0.05, "0.75 times gravity along z (0.67 to 0.83; model: 0)"),
        ("ln_plate_force", math.log(0.75), 0.05, "0.75 times the stated force (0.69 to 0.81; "),
        ("inclusion_ln_ratio", math.log(1.6), 0.1, "1.6 times as stiff as its surroundings (1.4"),
        ("ln_compressibility", math.log(5), 0.2, "nu = 0.45 (0.43 to 0.46; model: 0.49)"),
        ("ln_gradient_x", math.log(2), 0.1, "2.0 times as stiff at the end of x as in the middle"),
        ("creep", 0.2, 0.05, "20 % of the stiffness lost (12 to 28; model: 0)"),
        ("scale_y", 0.02, 0.002, "2.0 % larger along y (1.7 to 2.3; model: 0)"),
        ("friction", 0.3, 0.05, "coefficient = 0.30 (0.22 to 0.38; model: 0)"),
        ("tilt_depth", 5.4838, 0.2712, "5.5 deg (5.0 to 5.9; model: 0)"),
        ("ln_growth_fat", math.log(1.1), 0.01, "1.10 times the volume of fat at rest (1.08 to "),
        ("jet_pressure_part", math.log(0.8), 0.05, "0.80 times the stated pressure (0.74 to 0.87"),
    ],
)
def test_magnitudes_have_familiar_units(name: str, value: float, sd: float, expected: str) -> None:
    assert text(name, value, sd).startswith(expected)


def test_nu_of_a_body_with_several_materials_is_shown_as_a_ratio() -> None:
    said = text("ln_compressibility", math.log(5), 0.2, nu=None)
    assert said.startswith("5 times the model's 1 − 2 nu (4 to 7; model: 1)")


@pytest.mark.parametrize("name", PARAMETERS)
def test_no_parameter_is_shown_as_a_logarithm(name: str) -> None:
    one = PARAMETERS[name]
    logarithm = "ln" in name.split("_") or one.description.startswith("ln ")
    assert not logarithm or one.reading.kind in ("ratio", "poisson")
    said = read(one, one.unit.to_door(one.neutral or 0.0), 0.01)
    assert "ln" not in f"{said.name} {said.unit}".split()
    assert "ln" not in parameter_name(one.door_name, one.unit.symbol).split()
    assert said.low <= said.value <= said.high
    assert said.value == pytest.approx(said.neutral)
    assert said.unit or said.name


def test_shown_poisson_ratio_equals_the_applied_one() -> None:
    from palpate.workers.mechanics.effects.material_effects import COMPRESSIBILITY
    from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Frame, Problem
    from palpate.workers.mechanics.fem.loads_and_regions import ForceControl

    problem = Problem({2: Constants(0.01, 0.49)}, ForceControl(10.0, -5.0, 5.0))
    changed = COMPRESSIBILITY.apply(problem, {"ln_compressibility": 1.2}, Frame())
    found = read(PARAMETERS["ln_compressibility"], 1.2, 0.1)
    assert found.value == pytest.approx(changed.constants[2].poisson)


def with_gravity() -> Summary:
    """Return a diagnosis of a missing weight, in multiples of gravity."""
    found: Summary = from_json(Summary, summary())
    lead = ShownMagnitude(0.7512, 0.669, 0.833, 0.0, "times gravity along z")
    gravity = replace(found.effects[-1], name="gravity_change", shown=lead)
    effects = (*found.effects[:-1], gravity)
    return replace(found, effects=effects, primary=("gravity_change",))


def printed(found: Summary) -> str:
    console = Console(file=io.StringIO(), width=200)
    print_verdict(found, console)
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_headline_has_unit_interval_and_model_value() -> None:
    assert (
        "gravity change (0.75 times gravity along z, 0.67 to 0.83, model: 0, strong evidence)"
    ) in headline(with_gravity())


def test_the_terminal_lists_the_fitted_causes_with_their_evidence() -> None:
    lines = [" ".join(line.split()) for line in printed(with_gravity()).splitlines()]
    gravity = "gravity change strong 0.75 times gravity along z (0.67 to 0.83; model: 0) 1 %"
    assert lines.index(gravity) < lines.index("plate flex strong 8.0 ± 1.0 mm 5 %")
    assert not any(line.startswith("plate force") for line in lines)


def test_the_terminal_says_what_a_verdict_of_no_gap_rules_out() -> None:
    said = (
        "These scans would have shown, from this size on: plate flex 2 mm and plate tilt 1.3 deg."
    )
    silent = from_json(Summary, VERDICTS["no gap"])
    assert said in printed(silent)
    assert said not in printed(with_gravity())
    blind = [replace(one, seen_from=None) for one in silent.effects]
    assert power(replace(silent, effects=tuple(blind))) == ""


def test_the_least_visible_size_has_the_unit_of_the_magnitude() -> None:
    one = from_json(Summary, summary()).effects[0]
    for name, size, expected in (
        ("ln_plate_force", math.log(1.13), "13 %"),
        ("friction", 0.214, "0.21"),
        ("creep", 0.052, "5.2 %"),
        ("tilt_depth", 1.26, "1.3 deg"),
    ):
        parameter_read = PARAMETERS[name]
        least, unit = shown_change(parameter_read.reading, size, parameter_read.unit.symbol)
        assert seen_from(replace(one, seen_from=least, seen_unit=unit)) == expected
    for size, expected in ((math.inf, "–"), (101.0, "–"), (99.0, "99 %")):
        assert seen_from(replace(one, seen_from=size, seen_unit="%")) == expected


def test_json_has_displayed_and_fitted_values() -> None:
    found = with_gravity()
    record: Any = to_json(found)
    shown_effect = record["effects"][-1]
    assert shown_effect["shown"]["unit"] == "times gravity along z"
    assert shown_effect["shown"]["neutral"] == 0.0
    assert shown_effect["magnitude"] == 5.4838
    assert from_json(Summary, record) == found


def test_older_records_are_shown_with_a_standard_deviation() -> None:
    old = effect("old", "loading", 8.0, 0.0, parameter("a_mm", 5.48, 0.27, "mm"))
    found = from_json(Summary, summary(primary=[], effects=[old]))
    (row,) = tables.effect_table(found)
    assert row.magnitudes == (("a", "5.48 ± 0.27 mm"),)


def test_a_plan_shows_the_least_ratio_in_per_cent() -> None:
    one = PARAMETERS["ln_plate_force"]
    least, unit = shown_change(one.reading, math.log(1.13), "")
    plan = ParameterPlan("ln_plate_force", "", math.log(1.13), 0.5, unit, least, 65.0)
    assert planned_amounts([plan], "minimum") == "13 %"


@pytest.mark.parametrize(
    ("part", "expected"),
    [(1.5, "150 %"), (0.999, "100 %"), (0.0951, "9.5 %"), (23.0, "2300 %"), (0.0, "0 %")],
)
def test_shares_have_no_power_of_ten(part: float, expected: str) -> None:
    assert share(part) == expected


@pytest.mark.parametrize(("value", "digits"), [(99.6, 2), (999.7, 3), (9999.6, 4), (14790.0, 4)])
def test_a_number_that_rounds_up_has_no_power_of_ten(value: float, digits: int) -> None:
    assert number(value, digits) == f"{value:.0f}"


def test_parameters_with_a_unit_are_shown_unconverted() -> None:
    assert all(p.reading.kind == "as is" for p in BREAST_MODEL if p.unit.symbol)
