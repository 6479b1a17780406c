"""The public Python interface: documented, typed and complete."""

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import palpate
from palpate.service import errors_and_interrupts as cluster_errors
from palpate.storage import errors

EXAMPLE: dict[str, Any] = {
    "name": "small",
    "case": {"reference": {"phantom": {"preset": "250ml", "spacing_mm": 2}}},
    "target": {"constants": {"E_fat_kpa": 12}},
    "search": {"parameters": {"E_fat_kpa": [5, 20]}},
}


@pytest.mark.parametrize("name", [n for n in palpate.__all__ if not n.startswith("_")])
def test_every_public_name_is_documented(name: str) -> None:
    documented = inspect.getdoc(getattr(palpate, name)) or ""
    assert len(documented.splitlines()[0]) > 15
    if inspect.isclass(getattr(palpate, name)):
        for attribute, value in vars(getattr(palpate, name)).items():
            if inspect.isfunction(value) and not attribute.startswith("_"):
                assert inspect.getdoc(value), f"{name}.{attribute}"


def test_every_error_is_public() -> None:
    for module in (errors, cluster_errors):
        for name, value in vars(module).items():
            if inspect.isclass(value) and issubclass(value, palpate.PalpateError):
                assert getattr(palpate, name) is value


def returned_types(value: Any) -> Iterator[type]:
    """Return the project's types returned by a public function or a public class's methods."""
    functions = [value] if inspect.isfunction(value) else []
    if inspect.isclass(value) and value.__module__.count(".") == 1:
        members = [m.fget if isinstance(m, property) else m for m in vars(value).values()]
        functions = [m for m in members if inspect.isfunction(m) and not m.__name__.startswith("_")]
    optional = dict.fromkeys(("Client", "DataFrame", "Figure"), object)
    for function in functions:
        hints = get_type_hints(function, vars(sys.modules[function.__module__]) | optional)
        waiting = [hints.get("return")]
        while waiting:
            one = waiting.pop()
            waiting += get_args(one)
            if inspect.isclass(one) and one.__module__.startswith("palpate"):
                yield one


def test_every_returned_type_is_public() -> None:
    public = {name: getattr(palpate, name) for name in palpate.__all__}
    returned = {one for value in public.values() for one in returned_types(value)}
    assert returned <= set(public.values())
    assert palpate.Samples in returned
    assert not hasattr(palpate, "TetMesh")  # which nothing returns


def test_package_ships_type_marker() -> None:
    assert (Path(palpate.__file__).parent / "py.typed").is_file()


def test_rejects_invalid_study_and_names_key() -> None:
    with pytest.raises(palpate.InputError, match="did you mean"):
        palpate.study_spec(EXAMPLE | {"serch": {}})


def test_rejects_unknown_study_folder(tmp_path: Path) -> None:
    with pytest.raises(palpate.InputError):
        palpate.Study.open(tmp_path / "nowhere")
    with pytest.raises(palpate.InputError):
        _ = palpate.Study.from_dict(EXAMPLE, tmp_path / "new").results


def test_written_volume_reads_back_unchanged(tmp_path: Path) -> None:
    values = np.zeros((4, 5, 6), np.uint8)
    values[1:3, 1:4, 2:5] = palpate.Tissue.FAT
    volume = palpate.Volume(values, (1.5, 2.0, 0.5), (3.0, -4.0, 5.0))
    palpate.write_volume(tmp_path / "body.nrrd", volume)
    again = palpate.read_volume(tmp_path / "body.nrrd")
    np.testing.assert_array_equal(again.values, values)
    assert again.spacing_mm == volume.spacing_mm
    assert again.origin_mm == volume.origin_mm


def test_parameters_have_units() -> None:
    parameters = palpate.parameters()
    assert parameters["E_fat_kpa"].unit.to_door(parameters["E_fat_kpa"].lower) == 5
    assert "friction" in parameters
