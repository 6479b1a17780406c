"""The study file: valid content, and messages for typing errors."""

from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from palpate.service.study.study_keys import StudySpec, differences, parse_spec, read_spec
from palpate.service.templates import template
from palpate.storage.errors import InputError
from palpate.workers.common_keys import explain

SPEC = """
name: demo
case: {reference: {phantom: {preset: 445ml}}, mesh: {nodes: 2000}}
target: {constants: {E_fat_kpa: 10}}
search: {parameters: {E_fat_kpa: [5, 20], eta_fat_kpa: [50, 200]}}
"""


def parsed(text: str) -> StudySpec:
    return parse_spec(text, "study.yaml", Path())


def test_defaults_match_the_thesis() -> None:
    settings = parsed(SPEC).search.settings
    assert (settings.population, settings.generations, settings.elite) == (84, 15, 2)
    assert (settings.crossover_children, settings.mutation_children) == (66, 16)
    assert settings.stall is not None
    assert (settings.stall.generations, settings.stall.tolerance) == (5, 1e-6)


def test_genes_in_kpa_become_constants_in_mpa() -> None:
    assert parsed(SPEC).constants_of({"E_fat_kpa": 10.0, "eta_fat_kpa": 150.0}) == {
        "E_fat": 0.01,
        "eta_fat": 0.15,
    }


def test_study_round_trips() -> None:
    spec = parsed(SPEC + "seed: 3\nkeep: elites\n")
    assert StudySpec.model_validate(spec.as_dict()) == spec
    without_stall = parsed(SPEC.replace("eta_fat_kpa: [50, 200]}", "E_glandular_kpa: [5, 80]}"))
    assert without_stall.digest != spec.digest


def test_disabled_stall_survives_a_round_trip() -> None:
    spec = parsed(SPEC.replace("search: {", "search: {stall: null, "))
    assert spec.search.settings.stall is None
    assert StudySpec.model_validate(spec.as_dict()).search.stall is None


def test_an_exponent_without_a_point_is_a_number() -> None:
    """YAML 1.1 reads 1e-6 as text."""
    spec = parsed(SPEC.replace("search: {", "search: {stall: {tolerance: 1e-5}, "))
    assert spec.search.stall is not None
    assert spec.search.stall.tolerance == 1e-5


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("search: {", "serach: {", "did you mean 'search'"),
        ("mesh: {nodes", "mesh: {node", "did you mean 'nodes'"),
        ("[5, 20]", "[20, 5]", r"Write \[5, 20\]"),
        ("eta_fat_kpa: [50, 200]", "eta_fatt_kpa: [50, 200]", "did you mean 'eta_fat_kpa'"),
        ("search: {", "search: {elite: 84, ", "at least one candidate must be new"),
        ("search: {", "search: {population: many, ", "search.population"),
        ("name: demo", "name: ../demo", "name"),
        ("name: demo", "name: demo\nseed: -1", "seed"),
        ("name: demo", "name: demo\nname: twice", "is repeated on lines 2 and 3"),
        ("eta_fat_kpa: [50, 200]", "E_skin_kpa: [200, 900]", "case.model.skin is none"),
        ("{E_fat_kpa: 10}", "{E_fat_kpa: -10}", "target.constants"),
        ("mesh: {nodes: 2000}", "constants: {E_fat_kpa: 9}", "searched .* and held"),
        ("name: demo", "name: [demo", "not valid YAML"),
        (SPEC, "", "found nothing"),
        (SPEC, "- a\n- b\n", "found list"),
    ],
)
def test_typing_errors_are_named_with_a_correction(old: str, new: str, said: str) -> None:
    assert old in SPEC
    with pytest.raises(InputError, match=said) as caught:
        parsed(SPEC.replace(old, new))
    assert "study.yaml" in str(caught.value)


def test_missing_file_gives_the_command_that_writes_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="palpate new breast mine"):
        read_spec(tmp_path / "mine.yaml")
    with pytest.raises(InputError, match="is a folder"):
        read_spec(tmp_path)


def test_paths_are_relative_to_the_study_file(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "before.nrrd").touch()
    text = SPEC.replace("phantom: {preset: 445ml}", "volume: images/before.nrrd")
    text = text.replace("constants: {E_fat_kpa: 10}", "volume: imported-name")
    text = text.replace("case: {", "case: {load: {force_n: 60}, ")
    (tmp_path / "study.yaml").write_text(text)
    spec = read_spec(tmp_path / "study.yaml")
    assert spec.case.reference.volume == str(tmp_path.resolve() / "images" / "before.nrrd")
    assert spec.target.volume == "imported-name"


def test_differences_list_added_changed_and_removed_keys() -> None:
    before = {"a": {"b": 1, "c": 2}, "d": [1, 2]}
    now = {"a": {"b": 1, "c": 3}, "e": None}
    assert differences(before, now) == [
        "a.c: 2 before, 3 now",
        "d: [1, 2] before, absent now",
        "e: absent before, None now",
    ]


def test_template_values_match_the_stated_defaults() -> None:
    data = yaml.safe_load(template("breast", "mine"))
    data["target"]["constants"] = {"E_fat_kpa": 10}
    spec = StudySpec.model_validate(data)
    assert spec.name == "mine"
    assert spec.search.model_dump(exclude={"parameters"}) == parsed(SPEC).search.model_dump(
        exclude={"parameters"}
    )
    assert spec.score == parsed(SPEC).score
    assert spec.case.model == parsed(SPEC).case.model


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ([5], "expected 2 values in brackets, found [5]"),
        ([], "expected 2 values in brackets, found []"),
        ([5, 6, 7], "expected at most 2 values, found [5, 6, 7]"),
        ("5-20", "expected a list in brackets, such as [5, 20], found '5-20'"),
        (200, "expected a list in brackets, such as [5, 20], found 200"),
    ],
)
def test_bounds_of_another_form_are_rejected(found: object, message: str) -> None:
    data = parsed(SPEC).as_dict() | {"search": {"parameters": {"E_fat_kpa": found}}}
    with pytest.raises(ValidationError) as error:
        StudySpec.model_validate(data)
    assert f"search.parameters.E_fat_kpa: {message}" in explain(error.value)


def test_bounds_are_checked_on_input() -> None:
    data = parsed(SPEC).as_dict()
    good = StudySpec.model_validate(data | {"search": {"parameters": {"E_fat_kpa": [5, 20]}}})
    assert good.search.parameters == {"E_fat_kpa": (5, 20)}
    with pytest.raises(ValidationError) as error:
        StudySpec.model_validate(data | {"search": {"parameters": {"E_fat_kpa": [20, 5]}}})
    assert "Write [5, 20]" in explain(error.value)
