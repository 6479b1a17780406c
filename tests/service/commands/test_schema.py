"""JSON schemas printed by `palpate schema`."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from palpate.service.templates import template

Call = Callable[..., tuple[int, str, str]]
ROOT = Path(__file__).parents[3]
KINDS = (["study"], ["study", "--organ", "cornea"], ["diagnosis"], ["experiment"])


def properties(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for part in (schema, *schema["$defs"].values()):
        yield from part.get("properties", {}).items()


@pytest.mark.parametrize("kind", KINDS, ids=" ".join)
def test_keys_have_descriptions_and_unknown_ones_are_rejected(call: Call, kind: list[str]) -> None:
    code, out, _ = call("schema", *kind)
    schema = json.loads(out)
    assert code == 0
    assert [key for key, entry in properties(schema) if not entry.get("description")] == []
    assert schema["additionalProperties"] is False
    assert schema["$schema"].startswith("https://json-schema.org/")


@pytest.mark.parametrize(
    ("kind", "file"),
    [
        (["study"], "examples/demo.yaml"),
        (["study", "--organ", "cornea"], "examples/cornea-synthetic.yaml"),
        (["diagnosis"], "examples/diagnosis/hidden.yaml"),
        (["experiment"], "examples/beam.yaml"),
    ],
)
def test_accepts_example_and_rejects_typo(call: Call, kind: list[str], file: str) -> None:
    _, out, _ = call("schema", *kind)
    check = jsonschema.Draft202012Validator(json.loads(out))
    given = yaml.safe_load((ROOT / file).read_text())
    assert [error.message for error in check.iter_errors(given)] == []
    assert list(check.iter_errors(given | {"colour": "red"}))


def test_writes_schema_file(call: Call, tmp_path: Path) -> None:
    code, out, _ = call("schema", "study", "--out", str(tmp_path / "study.schema.json"))
    assert code == 0
    assert f"$schema={tmp_path / 'study.schema.json'}" in out
    assert json.loads((tmp_path / "study.schema.json").read_text())["title"] == "BreastStudy"


def test_an_unknown_kind_is_refused(call: Call) -> None:
    code, _, err = call("schema", "studdy")
    assert code == 2
    assert "did you mean 'study'" in err


def test_templates_name_only_keys_of_the_schema(call: Call) -> None:
    _, out, _ = call("schema", "study")
    names = {key for key, _ in properties(json.loads(out))}
    given = yaml.safe_load(template("breast", "mine"))
    assert set(given) <= names
    assert set(given["search"]) <= names
