"""The doctor finds what would spoil a run."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from service.doctor import _mixed, describe_process, try_kernels, try_store
from service.shadows import other_distributions, other_packages

ROOT = Path(__file__).parents[2]


def test_equal_processes_are_no_mix() -> None:
    here = describe_process()
    assert set(here["packages"]) == {"service", "workers", "storage"}
    assert _mixed({"client": here, "scheduler": here, "worker tcp://x": here}) == []


def test_other_code_and_other_libraries_are_named() -> None:
    here = describe_process()
    other: dict[str, Any] = here | {
        "source": "0" * 16,
        "packages": here["packages"] | {"workers": "/old/workers"},
        "versions": here["versions"] | {"numpy": "1.0"},
    }
    code, library = _mixed({"client": here, "worker tcp://x": other})
    assert "/old/workers" in code
    assert "install the same everywhere" in code
    assert library.startswith("worker tcp://x has numpy 1.0")


def test_store_and_kernels_are_tried(tmp_path: Any) -> None:
    assert try_store(str(tmp_path / "store"))["free_bytes"] > 0
    assert list((tmp_path / "store").glob(".palpate-probe*")) == []
    assert try_kernels()["threads"] >= 1


def doctor(place: Path, path: list[Path]) -> subprocess.CompletedProcess[str]:
    """Run `palpate doctor` in a folder, with these folders on PYTHONPATH."""
    return subprocess.run(
        [sys.executable, "-P", "-m", "palpate", "doctor"],
        cwd=place,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path))},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def other_project(tmp_path: Path) -> Path:
    """Return the folder of another project that has a package `service`."""
    package = tmp_path / "other" / "service"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('this is another project')")
    return package.parent


def test_a_project_earlier_on_the_path_is_named_instead_of_imported(
    tmp_path: Path, other_project: Path
) -> None:
    ran = doctor(tmp_path, [other_project, ROOT])
    assert ran.returncode == 2
    assert "problem: the package `service` of palpate" in ran.stderr
    assert f"Python finds {other_project / 'service'} before it" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_a_project_later_on_the_path_is_a_danger_to_other_processes(
    tmp_path: Path, other_project: Path
) -> None:
    ran = doctor(tmp_path, [ROOT, other_project])
    assert ran.returncode == 2
    assert f"problem: another `service` is on the path, {other_project / 'service'}" in ran.stderr
    assert "client: palpate" in ran.stdout


def test_a_module_counts_and_our_own_packages_do_not(tmp_path: Path) -> None:
    assert other_packages([str(ROOT)]) == []
    (tmp_path / "storage.py").write_text("")
    (problem,) = other_packages([str(ROOT), str(tmp_path), str(tmp_path)])
    assert str(tmp_path / "storage.py") in problem


def test_a_distribution_that_overwrites_ours_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert other_distributions() == []
    info = tmp_path / "warehouse-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: warehouse\nVersion: 1.0\n")
    (info / "top_level.txt").write_text("storage\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (problem,) = other_distributions()
    assert problem.startswith("the distribution warehouse has a package `storage`, too")
