"""Templates of `palpate new`, and the message that lists their missing keys."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from palpate.service.cli import main
from palpate.service.study.study_keys import StudySpec, study_of
from palpate.service.templates import template
from palpate.storage.errors import InputError
from palpate.workers.common_keys import Door, validated
from palpate.workers.file_keys import description_at
from palpate.workers.organs.breast.scanned_case_keys import CaseFile
from palpate.workers.organs.specimen.specimen_keys import SpecimenSpec
from tests.cases.filled_templates import filled, required

Command = Callable[..., tuple[int, str]]
HIDDEN = {"breast": ("E_fat_kpa", "eta_fat_kpa", "E_glandular_kpa", "eta_glandular_kpa")}
HIDDEN["cornea"] = ("mu1_pa", "alpha1", "mu2_pa", "alpha2")
MISSING = {kind: [f"target.constants.{n}" for n in names] for kind, names in HIDDEN.items()}
MISSING["breast-images"] = ["case.reference: volume", "case.load: force_n", "target: volume"]
MISSING["diagnosis"] = ["scans.reference", "scans.loads.0.volume", "scans.loads.0: force_n"]
MISSING["experiment"] = [
    "body: box_mm",
    *(
        f"regions.{name} end.plane.{key}"
        for name in ("held", "loaded")
        for key in ("axis", "at_mm")
    ),
    *(f"materials.material.{key}" for key in ("E_kpa", "nu", "density_kg_per_m3")),
    "down",
    "markers.rest_s",
    "markers.loaded_s",
    "markers.markers.M1.at_mm",
    "states.0.forces.0: force_n",
    "states.0.name",
    "states.0.files",
]
STUDIES = ("breast", "breast-images", "cornea")
RECORDS: dict[str, type[Door]] = {"diagnosis": CaseFile, "experiment": SpecimenSpec}


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Return a function that runs a command in an empty folder: exit code and output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str) -> tuple[int, str]:
        code = main(list(arguments))
        shown = capsys.readouterr()
        return code, shown.out + shown.err

    return run


@pytest.mark.parametrize("kind", MISSING)
def test_an_unedited_template_lists_every_missing_key(
    kind: str, command: Command, tmp_path: Path
) -> None:
    command("new", kind, "mine")
    for verb in ("run", "simulate") if kind in STUDIES else ("diagnose",):
        code, said = command(verb, "mine.yaml")
        assert code == 2
        first, *lines = said.strip().splitlines()
        assert first == "Error: mine.yaml is not finished. Fill in what is missing:"
        assert [re.sub(r"(: this key is| is) missing: .+", "", line.strip()) for line in lines] == (
            MISSING[kind]
        )
    assert [path.name for path in tmp_path.iterdir()] == ["mine.yaml"]


def test_an_unedited_diagnosis_cannot_be_planned(command: Command) -> None:
    command("new", "diagnosis", "mine")
    code, said = command("plan", "mine.yaml")
    assert (code, said.count("missing")) == (2, 4)


@pytest.mark.parametrize("kind", MISSING)
def test_every_missing_key_is_explained(kind: str) -> None:
    data = yaml.safe_load(template(kind, "mine"))
    record = (
        RECORDS[kind] if kind in RECORDS else study_of("cornea" if kind == "cornea" else "breast")
    )
    for key in MISSING[kind]:
        path = [int(k) if k.isdigit() else k for k in key.replace(": ", ".").split(".")]
        assert len(description_at(record, path)) > 3
    assert data["name"] == "mine"


@pytest.mark.parametrize("kind", STUDIES)
def test_a_study_template_shows_its_strategy(kind: str) -> None:
    text = template(kind, "mine")
    line = next(line for line in text.splitlines() if line.startswith("  strategy:"))
    assert yaml.safe_load(line)["strategy"] in ("genetic", "genetic+least-squares", "least-squares")
    assert "least-squares:" in text


def test_completed_image_template_equals_the_defaults() -> None:
    spec = StudySpec.model_validate(filled("breast-images", required("breast-images", 60.0)))
    least = {
        "name": "mine",
        "case": {"reference": {"volume": "rest.nrrd"}, "load": {"force_n": 60}},
        "target": {"volume": "pressed.nrrd"},
        "search": {"parameters": spec.search.parameters, "strategy": "least-squares"},
    }
    shown, bare = spec.as_dict(), StudySpec.model_validate(least).as_dict()
    assert shown["case"].pop("constants") == {"nu": 0.49}
    assert bare["case"].pop("constants") == {}
    assert shown == bare


def test_completed_diagnosis_template_equals_the_defaults() -> None:
    shown = CaseFile.model_validate(filled("diagnosis", required("diagnosis", 60.0)))
    least = {
        "name": "mine",
        "constants": shown.constants,
        "scans": {"reference": "rest.nrrd", "loads": [{"volume": "pressed.nrrd", "force_n": 60}]},
    }
    bare = CaseFile.model_validate(least)
    for key in ("model", "wall", "noise", "scans"):
        assert getattr(shown, key) == getattr(bare, key)
    assert (shown.plates.lower_mm, shown.plates.upper_mm) == (None, None)


def test_completed_experiment_template_is_valid() -> None:
    values = {
        "body.box_mm": [30, 30, 60],
        "regions.held end.plane": {"axis": "z", "at_mm": 0},
        "regions.loaded end.plane": {"axis": "z", "at_mm": 60},
        "materials.material.E_kpa": [50, 800],
        "materials.material.nu": 0.49,
        "materials.material.density_kg_per_m3": 1070,
        "down": [0, -1, 0],
        "markers.rest_s": [0, 0.25],
        "markers.loaded_s": [-1, 0],
        "markers.markers.M1.at_mm": [15, 30, 60],
        "states.0.name": "18 N",
        "states.0.forces.0.force_n": [0, 0, 18],
        "states.0.files": ["a.csv"],
    }
    spec = SpecimenSpec.model_validate(filled("experiment", values))
    assert spec.states[0].forces[0].force_n == (0, 0, 18)
    assert spec.markers is not None
    assert spec.markers.markers["M1"].outward is None


@pytest.mark.parametrize("load", [{}, {"load": None}])
def test_load_of_an_image_has_no_default(load: dict[str, object]) -> None:
    data = filled("breast-images", required("breast-images", 60.0))
    del data["case"]["load"]
    data["case"] |= load
    with pytest.raises(InputError, match=r"case\.load: this key is missing"):
        validated(StudySpec, data, "mine.yaml")


@pytest.mark.parametrize(
    ("load", "lacking"),
    [
        ({}, "case.load.iop_mmhg and case.load.jet"),
        ({"iop_mmhg": 15}, "case.load.jet"),
        ({"jet": {"pressure_kpa": 15}}, "case.load.iop_mmhg"),
    ],
)
def test_load_of_an_imaged_cornea_has_no_default(load: dict[str, object], lacking: str) -> None:
    picture = {"file": "a.png", "pixel_mm": [0.0156, 0.0165]}
    data = {
        "name": "eye",
        "case": {"organ": "cornea", "reference": {"frame": picture}, "load": load},
        "target": {"frame": picture},
        "search": {"parameters": {"mu1_pa": [1, 40000]}},
    }
    with pytest.raises(InputError, match=f"  {lacking}: this key is missing"):
        validated(StudySpec, data, "eye.yaml")


def test_an_empty_optional_key_has_its_default() -> None:
    data = filled("breast-images", required("breast-images", 60.0))
    data |= {"seed": None, "score": None, "keep": None}
    data["search"] |= {"population": None, "strategy": None}
    spec = StudySpec.model_validate(data)
    assert (spec.seed, spec.keep, spec.search.population) == (1, "best", 84)
    assert spec.search.strategy == "genetic"


def test_null_is_kept_for_nullable_keys() -> None:
    data = filled("breast-images", required("breast-images", 60.0))
    data["search"]["stall"] = None
    assert StudySpec.model_validate(data).search.stall is None


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("breast-images", "search.parameters.E_fat_kpa"),
        ("breast-images", "case.constants.nu"),
        ("diagnosis", "constants.eta_fat_kpa"),
        ("diagnosis", "name"),
    ],
)
def test_an_emptied_key_is_missing(kind: str, path: str) -> None:
    record = StudySpec if kind == "breast-images" else CaseFile
    with pytest.raises(InputError) as error:
        validated(record, filled(kind, required(kind, 60.0) | {path: None}), "mine.yaml")
    assert "is not finished" in str(error.value)
    assert f"  {path}: this key is missing: " in str(error.value)


def test_missing_and_wrong_keys_are_in_one_message() -> None:
    data = filled("diagnosis", required("diagnosis", -4.0) | {"scans.reference": None})
    with pytest.raises(InputError) as error:
        validated(CaseFile, data, "mine.yaml")
    head, *lines = str(error.value).splitlines()
    assert head == "mine.yaml does not make sense:"
    assert [line.split(": ")[0].strip() for line in lines] == [
        "scans.reference",
        "scans.loads.0.force_n",
    ]
