"""Keys of a study file, and the errors for invalid ones."""

import pytest
from pydantic import ValidationError

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.common_keys import validated
from palpate.workers.organs.breast.breast_keys import (
    BreastCase,
    BreastScore,
    BreastTarget,
    LoadSpec,
    MeshSpec,
    PlateDistanceSpec,
)

PHANTOM = {"phantom": {"spacing_mm": 2.0}}


def case(**keys):
    return validated(BreastCase, {"reference": PHANTOM} | keys, "study.yaml")


def refusal(model, data):
    with pytest.raises(InputError) as error:
        validated(model, data, "study.yaml")
    return str(error.value)


def test_the_smallest_case_is_the_first_target_of_the_thesis():
    small = case()
    assert small.load.force_n == 100
    assert small.model.skin == "none"
    assert small.complete()["E_fat"] == 0.01
    assert small.complete()["nu"] == 0.49


def test_constants_are_converted_from_kpa_to_mpa():
    assert case(constants={"E_fat_kpa": 7.5}).complete()["E_fat"] == 0.0075


def test_candidate_overrides_the_case_and_sets_muscle():
    values = case(constants={"E_fat_kpa": 7.5, "nu": 0.48}).complete({"E_fat": 0.012})
    assert (values["E_fat"], values["E_muscle"], values["nu"]) == (0.012, 0.012, 0.48)


def test_a_phantom_is_a_preset_with_changes():
    settings = validated(
        BreastCase, {"reference": {"phantom": {"preset": "250ml", "spacing_mm": 0.5, "skin_mm": 0}}}
    ).reference.phantom.settings
    assert settings == BreastPhantom.preset("250ml", spacing_mm=0.5, skin_mm=0.0)


def test_case_survives_json():
    whole = case(
        mesh={"element_size_mm": 6},
        model={"skin": "membrane", "skin_thickness_mm": 1.2, "fibres": "literal"},
        load={"plate_distance_mm": {"initial": 126.7, "final": 65.07}},
        constants={"E_fat_kpa": 12.0},
    )
    assert BreastCase.model_validate_json(whole.model_dump_json()) == whole
    assert BreastCase.model_validate(whole.model_dump(mode="json")) == whole


def test_image_survives_json():
    image = validated(
        BreastCase,
        {"reference": {"volume": "a.npy", "labels": {0: "air", 1: "Fat"}, "spacing_mm": 0.5}},
    )
    assert image.reference.labels == {0: "air", 1: "fat"}
    assert image.reference.spacing_mm == (0.5, 0.5, 0.5)
    assert BreastCase.model_validate_json(image.model_dump_json()) == image


def test_a_case_cannot_be_changed():
    with pytest.raises(ValidationError):
        case().organ = "cornea"


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"refernce": PHANTOM}, "unknown key 'refernce': did you mean 'reference'?"),
        (
            {"reference": PHANTOM, "load": {"forse_n": 3}},
            "load: unknown key 'forse_n': did you mean 'force_n'?",
        ),
        (
            {"reference": PHANTOM, "mesh": {"node": 300}},
            "mesh: unknown key 'node': did you mean 'nodes'?",
        ),
        (
            {"reference": PHANTOM, "constants": {"E_fat": 10}},
            "constants: unknown parameter 'E_fat': did you mean 'E_fat_kpa'?",
        ),
        (
            {"reference": {"phantom": {}, "volume": "a.nrrd"}},
            "reference: give exactly one of phantom and volume, found both",
        ),
        (
            {"reference": PHANTOM | {"labels": {0: "air"}}},
            "reference: labels can only be used with an image, but a phantom is given",
        ),
        (
            {"reference": {"phantom": {"spacing_mm": 0}}},
            "reference.phantom: spacing_mm must be between 0.2 and 2 mm, got 0",
        ),
        (
            {"reference": {"phantom": {"preset": "450ml"}}},
            "reference.phantom: Unknown phantom preset '450ml'; use one of 445ml, 250ml",
        ),
        (
            {"reference": {"phantom": {"skin": 2}}},
            "reference.phantom: unknown key 'skin': did you mean 'skin_mm'?",
        ),
        (
            {"reference": {"volume": "a", "spacing_mm": [1, 0, 1]}},
            "reference.spacing_mm.1: Input should be greater than 0, found 0",
        ),
        (
            {"reference": {"volume": "a", "labels": {1: "fet"}}},
            "reference.labels: 1: 'fet' is not a tissue. Did you mean fat?",
        ),
        (
            {"reference": PHANTOM, "constants": {"E_glandular_kpa": -4}},
            "constants: E_glandular_kpa must be above 0 kPa, found -4",
        ),
        (
            {"reference": PHANTOM, "model": {"skin": "leather"}},
            "model.skin: Input should be 'none', 'membrane' or 'layer', found 'leather'",
        ),
    ],
)
def test_error_names_key_and_problem(data, told):
    message = refusal(BreastCase, data)
    assert message.startswith("study.yaml does not make sense:")
    assert told in message


@pytest.mark.parametrize(
    ("data", "lacking"),
    [
        ({}, "reference: this key is missing"),
        ({"reference": {}}, "reference: give exactly one of phantom and volume, found neither"),
    ],
)
def test_case_without_a_body_is_incomplete(data, lacking):
    message = refusal(BreastCase, data)
    assert message.startswith("study.yaml is not finished")
    assert lacking in message


def test_reports_all_unknown_keys_at_once():
    message = refusal(BreastCase, {"reference": PHANTOM, "laod": {}, "mehs": {}})
    assert "'laod': did you mean 'load'" in message
    assert "'mehs': did you mean 'mesh'" in message
    message = refusal(
        BreastCase, {"reference": PHANTOM, "load": {"force_n": -1}, "mesh": {"nodes": 3}}
    )
    assert "load.force_n" in message
    assert "mesh.nodes" in message


@pytest.mark.parametrize("found", [{}, {"nodes": 500, "element_size_mm": 5}])
def test_a_mesh_needs_exactly_one_size(found):
    assert "exactly one of nodes and element_size_mm" in refusal(MeshSpec, found)


@pytest.mark.parametrize("found", [{}, {"force_n": 100, "plate_distance_mm": {"final": 60}}])
def test_a_load_needs_exactly_one_control(found):
    assert "exactly one of force_n and plate_distance_mm" in refusal(LoadSpec, found)


@pytest.mark.parametrize(
    "found",
    [
        {},
        {"initial": 60},
        {"lower": 3},
        {"final": 60, "lower": 3},
        {"initial": 9, "lower": 1, "upper": 2},
    ],
)
def test_plates_end_at_a_distance_or_at_two_positions(found):
    assert "give {final: 65}" in refusal(PlateDistanceSpec, found)


def test_plates_cannot_move_apart():
    assert "final (70) must be less than initial (60)" in refusal(
        PlateDistanceSpec, {"initial": 60, "final": 70}
    )
    assert "lower (7) must be less than upper (6)" in refusal(
        PlateDistanceSpec, {"lower": 7, "upper": 6}
    )


def test_a_target_needs_exactly_one_source():
    assert "exactly one of constants and volume" in refusal(BreastTarget, {})
    assert "a mesh is for a simulated target" in refusal(
        BreastTarget, {"volume": "a", "mesh": {"nodes": 500}}
    )
    assert "axes can only be used with an image" in refusal(
        BreastTarget, {"constants": {}, "axes": "x,y,z"}
    )


def test_rejects_axes_that_mirror_the_body():
    assert "mirror" in refusal(BreastTarget, {"volume": "a", "axes": "z,y,x"})


def test_a_score_names_tissues_once():
    score = BreastScore(labels=["Fat", "glandular"])
    assert score.tissues == (Tissue.FAT, Tissue.GLANDULAR)
    assert "air is not a tissue" in refusal(BreastScore, {"labels": ["air"]})
    assert "name each tissue once" in refusal(BreastScore, {"labels": ["fat", "Fat"]})
    assert "at least 1 value" in refusal(BreastScore, {"labels": []})


def test_skin_that_is_not_modelled_cannot_be_searched():
    assert "E_skin" not in case().parameters
    assert "E_skin" in case(model={"skin": "membrane"}).parameters
