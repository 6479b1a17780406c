"""The public Python face: documented, typed, and nothing but what it promises."""

import doctest
import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate

EXAMPLE: dict[str, Any] = {
    "name": "small",
    "case": {"reference": {"phantom": {"preset": "250ml", "spacing_mm": 2}}},
    "target": {"constants": {"E_fat_kpa": 12}},
    "search": {"parameters": {"E_fat_kpa": [5, 20]}},
}


def test_the_examples_in_the_documentation_are_true() -> None:
    assert doctest.testmod(palpate).attempted > 3
    assert doctest.testmod(palpate).failed == 0


@pytest.mark.parametrize("name", [n for n in palpate.__all__ if not n.startswith("_")])
def test_every_public_name_is_documented(name: str) -> None:
    documented = inspect.getdoc(getattr(palpate, name)) or ""
    assert len(documented.splitlines()[0]) > 15
    if inspect.isclass(getattr(palpate, name)):
        for attribute, value in vars(getattr(palpate, name)).items():
            if inspect.isfunction(value) and not attribute.startswith("_"):
                assert inspect.getdoc(value), f"{name}.{attribute}"


def test_the_types_are_shipped() -> None:
    assert (Path(palpate.__file__).parent / "py.typed").is_file()


def test_a_study_that_makes_no_sense_is_refused_with_the_key() -> None:
    with pytest.raises(palpate.InputError, match="did you mean"):
        palpate.study_spec(EXAMPLE | {"serch": {}})


def test_a_study_of_an_unknown_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(palpate.InputError):
        palpate.Study.open(tmp_path / "nowhere")
    with pytest.raises(palpate.InputError):
        _ = palpate.Study.from_dict(EXAMPLE, tmp_path / "new").results


def test_a_volume_that_is_written_reads_back_the_same(tmp_path: Path) -> None:
    values = np.zeros((4, 5, 6), np.uint8)
    values[1:3, 1:4, 2:5] = palpate.Tissue.FAT
    volume = palpate.Volume(values, (1.5, 2.0, 0.5), (3.0, -4.0, 5.0))
    palpate.write_volume(tmp_path / "body.nrrd", volume)
    again = palpate.read_volume(tmp_path / "body.nrrd")
    np.testing.assert_array_equal(again.values, values)
    assert again.spacing_mm == volume.spacing_mm
    assert again.origin_mm == volume.origin_mm


def test_parameters_carry_their_units() -> None:
    parameters = palpate.parameters()
    assert parameters["E_fat_kpa"].unit.to_door(parameters["E_fat_kpa"].lower) == 5
    assert "friction" in parameters
