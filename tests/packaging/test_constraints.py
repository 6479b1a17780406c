"""The pinned versions cover the requirements in pyproject.toml and contain no addresses."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[2]
LINES = (ROOT / "constraints.txt").read_text().splitlines()
PYPROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS: dict[str, list[str]] = PYPROJECT["project"]["optional-dependencies"]
HINT = "run `make constraints` after changing the dependencies"


def pins() -> dict[str, Version]:
    split = [line.split("==") for line in LINES]
    return {canonicalize_name(name): Version(version) for name, version in split}


def test_every_line_is_a_name_and_a_version() -> None:
    for line in LINES:
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*==[A-Za-z0-9.!+_-]+", line), line


def test_contains_no_address_or_path() -> None:
    text = "\n".join(LINES)
    for sign in ("://", "@", "/", "--"):
        assert sign not in text


def test_names_are_unique_and_exclude_palpate() -> None:
    names = [canonicalize_name(line.partition("==")[0]) for line in LINES]
    assert len(names) == len(set(names))
    assert "palpate" not in names


@pytest.mark.parametrize(
    "asked",
    [*PYPROJECT["project"]["dependencies"], *PYPROJECT["build-system"]["requires"], *EXTRAS["dev"]],
)
def test_every_dependency_is_pinned_to_a_version_it_allows(asked: str) -> None:
    requirement = Requirement(asked)
    pinned = pins().get(canonicalize_name(requirement.name))
    assert pinned is not None, f"{requirement.name} is not in constraints.txt: {HINT}"
    assert requirement.specifier.contains(pinned), f"{asked} does not allow {pinned}: {HINT}"


def test_extras_allow_the_pinned_versions() -> None:
    for asked in (line for extra in EXTRAS.values() for line in extra):
        requirement = Requirement(asked)
        pinned = pins().get(canonicalize_name(requirement.name))
        assert pinned is None or requirement.specifier.contains(pinned), asked
