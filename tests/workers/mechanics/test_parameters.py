"""Names, units, bounds and neutral values of parameters, in files and in the code."""

import math

import pytest

from palpate.storage.errors import InputError
from palpate.workers.mechanics.model_parameters import (
    BREAST,
    KPA,
    NUMBER,
    Parameter,
    Vocabulary,
    unknown_name,
)

FRICTION = Parameter(
    "friction", NUMBER, 0.0, 0.5, 0.0, "of the plates", admissible=(0.0, 1.0), open_lower=False
)


def test_converts_kilopascals_to_megapascals():
    assert BREAST.from_door({"E_fat_kpa": 10}) == {"E_fat": 0.01}
    assert BREAST.to_door({"E_fat": 0.01}) == {"E_fat_kpa": 10.0}


@pytest.mark.parametrize("kpa", [0.1, 3.0, 7.5, 10.0, 36.75, 112.5, 1643.1])
def test_stiffness_survives_a_round_trip(kpa):
    assert KPA.to_door(KPA.to_inside(kpa)) == pytest.approx(kpa, rel=1e-15)


def test_pure_number_has_no_unit_in_its_name():
    assert BREAST["nu"].door_name == "nu"
    assert KPA.name_at_door("E_fat") == "E_fat_kpa"
    assert KPA.text(0.01) == "10 kPa"
    assert NUMBER.text(0.49) == "0.49"


@pytest.mark.parametrize(
    ("name", "lower_kpa", "upper_kpa"),
    [
        ("E_fat", 5, 20),
        ("eta_fat", 50, 200),
        ("E_glandular", 5, 80),
        ("eta_glandular", 50, 200),
        ("E_skin", 200, 3000),
    ],
)
def test_default_intervals_match_the_thesis(name, lower_kpa, upper_kpa):
    assert BREAST[name].bounds == (lower_kpa / 1000, upper_kpa / 1000)


def test_neutral_values_are_the_first_target_of_the_thesis():
    values = BREAST.complete()
    wanted = {"E_fat": 0.01, "eta_fat": 0.1, "E_glandular": 0.04, "eta_glandular": 0.15}
    assert {name: values[name] for name in wanted} == wanted
    assert values["E_skin"] == 1.6
    assert values["nu"] == 0.49


def test_muscle_follows_fat_until_it_is_given():
    assert BREAST.complete({"E_fat": 0.007})["E_muscle"] == 0.007
    assert BREAST.complete({"E_fat": 0.007, "E_muscle": 0.06})["E_muscle"] == 0.06


def test_last_given_value_applies():
    assert BREAST.complete({"E_fat": 0.007}, {"E_fat": 0.008})["E_fat"] == 0.008


@pytest.mark.parametrize("value", [-1.0, 0.0, math.inf, math.nan])
def test_rejects_modulus_that_is_not_positive(value):
    with pytest.raises(InputError, match="E_fat_kpa must be above 0 kPa"):
        BREAST.from_door({"E_fat_kpa": value})


def test_fibres_may_be_absent_but_not_negative():
    assert BREAST.from_door({"eta_fat_kpa": 0}) == {"eta_fat": 0.0}
    with pytest.raises(InputError, match="at least 0 kPa, found -1"):
        BREAST.from_door({"eta_fat_kpa": -1})


def test_rejects_incompressible_body():
    with pytest.raises(InputError, match=r"nu must be above 0 and below 0\.5, found 0\.5"):
        BREAST.from_door({"nu": 0.5})


def test_reversed_bounds_show_the_right_order():
    with pytest.raises(InputError, match=r"found \[20, 5\]\. Write \[5, 20\]\."):
        BREAST.bounds_from_door({"E_fat_kpa": (20, 5)})


def test_rejects_empty_interval():
    with pytest.raises(InputError, match="hold it at one value"):
        BREAST.bounds_from_door({"E_fat_kpa": (5, 5)})


def test_bounds_follow_the_order_of_the_vocabulary():
    bounds = BREAST.bounds_from_door({"E_glandular_kpa": (5, 80), "E_fat_kpa": (5, 20)})
    assert list(bounds.items()) == [("E_fat", (0.005, 0.02)), ("E_glandular", (0.005, 0.08))]


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [("E_fat", "E_fat_kpa"), ("e_fat_kpa", "E_fat_kpa"), ("eta_glandula_kpa", "eta_glandular_kpa")],
)
def test_misspelt_name_suggests_the_nearest(wrong, meant):
    with pytest.raises(InputError, match=f"did you mean '{meant}'"):
        BREAST.from_door({wrong: 1})


def test_unknown_name_lists_all_names():
    assert unknown_name("key", "zzz", ["a", "b"]) == "unknown key 'zzz': known are a, b"


def test_effect_parameter_is_neutral_by_default():
    larger = BREAST.extended_by([FRICTION])
    assert larger.names == (*BREAST.names, "friction")
    assert larger.complete() == {**BREAST.complete(), "friction": 0.0}
    assert "friction" not in BREAST


def test_vocabulary_can_omit_a_name():
    assert "E_skin" not in BREAST.without(["E_skin"])
    assert len(BREAST.without(["E_skin"])) == len(BREAST) - 1


def test_rejects_repeated_names():
    with pytest.raises(InputError, match="defined twice"):
        Vocabulary([FRICTION, FRICTION])


def test_rejects_following_a_later_parameter():
    follower = Parameter("b", NUMBER, 0.1, 0.2, None, "", follows="friction")
    with pytest.raises(InputError, match="not defined before"):
        Vocabulary([follower, FRICTION])


def test_rejects_parameter_without_a_value():
    with pytest.raises(InputError, match="neutral"):
        Parameter("b", NUMBER, 0.1, 0.2, None, "")


def test_rejects_inadmissible_neutral_value():
    with pytest.raises(InputError, match="and below 1, found 2"):
        Parameter("b", NUMBER, 0.1, 0.2, 2.0, "", admissible=(0.0, 1.0))
