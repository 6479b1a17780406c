"""The wheel contains one package with all of its modules, and nothing else."""

import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("service", "workers", "storage")
BUILD = ("--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built without a network by the installed hatchling."""
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    return built_from(ROOT, tmp_path_factory.mktemp("wheel"))


def built_from(source: Path, folder: Path) -> Path:
    built = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *BUILD, "--wheel-dir", folder, source],
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
    here = {path.relative_to(ROOT).as_posix() for path in (ROOT / "palpate").rglob("*.py")}
    packed = {name.as_posix() for name in names if name.suffix == ".py"}
    assert packed == here
    assert not [name for name in names if "__pycache__" in name.parts]
    assert not [name for name in names if {"tests", "examples", "runs"} & set(name.parts)]


def test_mammogram_tables_are_in_the_wheel(names: list[PurePosixPath]) -> None:
    tables = (ROOT / "palpate").rglob("xray_tables/*.csv")
    here = {path.relative_to(ROOT).as_posix() for path in tables}
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
        "names = 'palpate.storage.values', 'palpate.service.search.genetic_search', 'palpate'\n"
        "for name in names:\n"
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


def test_an_archive_without_links_gives_a_wheel_that_imports(tmp_path: Path) -> None:
    """`zipfile` and a clone on Windows turn a link into a small text file."""
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    if not (ROOT / ".git").exists():
        pytest.skip("an archive is made of the tracked files, and this is no repository")
    source = tmp_path / "source"
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in listed.stdout.split("\0"):
        if name in PACKAGES:
            (source / name).write_text(str((ROOT / name).readlink()))
        elif name and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    venv.create(tmp_path / "new", symlinks=True)
    python = tmp_path / "new" / "bin" / "python"
    wheel = built_from(source, tmp_path / "wheel")
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--no-deps"]
    subprocess.run([*install, "--no-index", wheel], capture_output=True, check=True)
    (packages,) = (tmp_path / "new" / "lib").glob("python*/site-packages")
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    script = "import palpate.service.cli, palpate.workers, palpate.storage; print(palpate.__file__)"
    done = subprocess.run(
        [python, "-P", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "new")


@pytest.mark.parametrize("name", PACKAGES)
def test_a_link_of_the_checkout_refuses_to_be_imported(name: str) -> None:
    assert (ROOT / name).resolve() == ROOT / "palpate" / name
    done = subprocess.run(
        [sys.executable, "-c", f"import {name}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last == (
        f"ImportError: Import palpate.{name}: a checkout's folder {name} is a link to it."
    )
