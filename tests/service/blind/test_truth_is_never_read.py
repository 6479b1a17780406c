"""A diagnosis opens the files of its case, but none of the truth in the folder next to it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.blind.blind_at_hand import LOADS, write_small
from tests.service.diagnosis.compressed_breast import read_settings

HERE = Path(__file__).parent
ROOT = HERE.parents[2]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A case and its truth side by side; the case itself also contains a copy of the truth."""
    home = tmp_path_factory.mktemp("beside").resolve()
    case, truth = home / "case", home / "truth"
    case.mkdir()
    truth.mkdir()
    write_small("tilt", LOADS[:1], case, truth)
    (case / "truth.json").write_bytes((truth / "truth.json").read_bytes())
    return case, truth


@pytest.fixture(scope="module")
def opened(
    folders: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, set[Path]]:
    """Paths opened or listed by a diagnosis in a separate process, and by this test."""
    case, truth = folders
    store = tmp_path_factory.mktemp("store") / "store"
    command = [sys.executable, HERE.parent / "open_files.py", case, store, truth / "truth.npz"]
    ran = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=240,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert ran.returncode == 0, ran.stderr
    return {who: {Path(p) for p in paths} for who, paths in json.loads(ran.stdout).items()}


def test_diagnosis_opens_no_truth(folders: tuple[Path, Path], opened: dict[str, set[Path]]) -> None:
    case, truth = folders
    seen = opened["by_the_diagnosis"]
    scans = read_settings(case)["scans"]
    named = ["case.yaml", scans["reference"], *(d["volume"] for d in scans["loads"])]
    assert {path for path in seen if case in path.parents} == {case / name for name in named}
    assert not [path for path in seen if path == truth or truth in path.parents]
    assert case.parent not in seen  # nor is their common folder listed


def test_access_to_the_truth_would_be_detected(
    folders: tuple[Path, Path], opened: dict[str, set[Path]]
) -> None:
    assert folders[1] / "truth.npz" in opened["by_us"]


def test_diagnosis_imports_no_module_that_makes_or_opens_cases() -> None:
    modules = "palpate.service.blind.diagnosed_case, palpate.workers.tasks.diagnosis_tasks"
    lines = f"import sys; import {modules}; print(*sys.modules)"
    ran = subprocess.run(
        [sys.executable, "-c", lines], capture_output=True, text=True, check=True, cwd=ROOT
    )
    imported = set(ran.stdout.split())
    assert "palpate.workers.diagnosis.verdict.diagnosis_course" in imported
    assert not [name for name in imported if name.startswith("palpate.workers.blind")]
    assert not imported & {
        "palpate.service.blind.set_making",
        "palpate.service.blind.case_truth",
        "palpate.service.blind.set_scoring",
    }
