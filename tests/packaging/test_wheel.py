"""The wheel contains one package with all of its modules, and nothing else."""

import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("service", "workers", "storage")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built without a network by the installed hatchling."""
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    folder = tmp_path_factory.mktemp("wheel")
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    built = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *options, "--wheel-dir", folder, ROOT],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def names(wheel: Path) -> list[PurePosixPath]:
    with zipfile.ZipFile(wheel) as archive:
        return [PurePosixPath(name) for name in archive.namelist()]


def test_only_palpate_can_be_imported(wheel: Path, names: list[PurePosixPath]) -> None:
    assert wheel.name.startswith("palpate-")
    assert wheel.name.endswith("-py3-none-any.whl")
    tops = {name.parts[0] for name in names}
    (metadata,) = tops - {"palpate"}
    assert metadata.startswith("palpate-")
    assert metadata.endswith(".dist-info")
    assert "palpate" in tops


def test_contains_every_module_and_nothing_unwanted(names: list[PurePosixPath]) -> None:
    here = {
        f"palpate/{path.relative_to(ROOT).as_posix()}"
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
    for path in [*(ROOT / "palpate").glob("*.py"), *(ROOT / "palpate" / "testing").glob("*.py")]:
        here.add(path.relative_to(ROOT).as_posix())
    packed = {name.as_posix() for name in names if name.suffix == ".py"}
    assert packed == here
    assert not [name for name in names if "__pycache__" in name.parts]
    assert not [name for name in names if {"tests", "examples", "runs"} & set(name.parts)]


def test_mammogram_tables_are_in_the_wheel(names: list[PurePosixPath]) -> None:
    tables = (ROOT / "workers").rglob("tables/*.csv")
    here = {f"palpate/{p.relative_to(ROOT).as_posix()}" for p in tables}
    assert len(here) == 7
    assert {name.as_posix() for name in names if name.suffix == ".csv"} == here


def test_contains_the_command_and_the_licence(wheel: Path, names: list[PurePosixPath]) -> None:
    (scripts,) = [name for name in names if name.name == "entry_points.txt"]
    with zipfile.ZipFile(wheel) as archive:
        assert "palpate = palpate.__main__:main" in archive.read(str(scripts)).decode()
    assert [name for name in names if name.parts[-2:] == ("licenses", "LICENSE")]


def test_the_packages_of_the_wheel_import_without_the_repository(
    wheel: Path, tmp_path: Path
) -> None:
    """A missing module or data file would make this fail."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    script = (
        "import importlib, sys; sys.path.insert(0, sys.argv[1])\n"
        "for name in ('palpate.storage.values', 'palpate.service.search.genetic', 'palpate'):\n"
        "    print(importlib.import_module(name).__file__)\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, tmp_path],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    for line in done.stdout.splitlines():
        assert Path(line).is_relative_to(tmp_path), line
