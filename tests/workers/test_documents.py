"""Documents hold plain values only, of a bounded size."""

import time
from typing import Any

import pytest

from palpate.storage.errors import InputError
from palpate.workers.input_files import parse_json, parse_yaml

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
)


@pytest.mark.parametrize(
    "text",
    [
        "a: !!binary L2V0Yy9wYXNzd2Q=",
        "a: !!set {/etc/passwd}",
        "a: !!omap [/etc/passwd: 1]",
        "a: !!pairs [/etc/passwd: 1]",
        "a: !!timestamp 2001-01-01",
        "a: !!python/name:os.system",
        "!!binary a: 1",
        "? [a]\n: 1",
        "? {a: b}\n: 1",
        "a: !x y",
        BOMB,
        "a: " + "9" * 19,
        "a: " + "9" * 5000,
        "a: 0x" + "f" * 40,
        "[" * 100_000,
        "[" * 101 + "]" * 101,
        "{a: " * 100_000,
        "- " * 100_000,
        "a: &a [*a]",
        "a: \x00",
        "a: 1\na: 2",
        "a: [1, 2",
        "%YAML 9.9\n---\nx",
        "a: 1\n---\nb: 2",
    ],
)  # fmt: skip
def test_refuses_invalid_yaml(text: str) -> None:
    began = time.monotonic()
    with pytest.raises(InputError, match=r"^The file"):
        parse_yaml(text, "The file")
    assert time.monotonic() - began < 10


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, '{"a": ' + "9" * 19 + "}", "9" * 5000, '{"a": 1,}']
)
def test_refuses_invalid_json(text: str) -> None:
    with pytest.raises(InputError, match=r"^The file"):
        parse_json(text, "The file")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: 2001-01-01", {"a": "2001-01-01"}),
        ("a: 2001-99-99", {"a": "2001-99-99"}),
        ("a: [1, 2.5, yes, ~, 1e-3, 0x1f]", {"a": [1, 2.5, "yes", None, 0.001, 31]}),
        ("1: x", {1: "x"}),
        ("a: &a {b: 1}\nc: {<<: *a, d: 2}", {"a": {"b": 1}, "c": {"b": 1, "d": 2}}),
        ("a: &a [1]\nb: *a", {"a": [1], "b": [1]}),
        ("", None),
    ],
)
def test_reads_plain_values(text: str, value: Any) -> None:
    assert parse_yaml(text, "The file") == value
