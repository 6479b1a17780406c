"""A case through the commands: written, read as YAML or JSON, echoed; prose is rejected."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_sources import (
    is_plannable,
    open_planned,
    open_source,
    understood,
)
from tests.service.diagnosis.compressed_breast import SCANS, described, write_scan, write_settings

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A block of fat around glandular tissue, which also represents its scans."""
    folder = tmp_path / "small"
    folder.mkdir()
    values = np.zeros((10, 14, 14), np.uint8)
    values[1:-1, 1:-1, 1:-1] = Tissue.FAT
    values[3:-3, 4:-4, 4:-4] = Tissue.GLANDULAR
    for file in SCANS:
        write_scan(folder / file, Volume(values, (4.0, 4.0, 4.0), (-26.0, -26.0, 0.0)))
    write_settings(folder, described())
    return folder


def test_a_folder_and_its_file_are_one_case(case: Path) -> None:
    contents = [ScannedCaseSource(read_case(path)).content for path in (case, case / "case.yaml")]
    assert contents[0].record == contents[1].record
    for path in (case, case / "case.yaml"):
        assert is_plannable(path)
        assert open_planned(path).acquisition.loads == ["8 N", "20 N"]


def test_structured_json_is_read_too(case: Path) -> None:
    record = read_case(case).file.record
    (case / "case.yaml").unlink()
    (case / "case.json").write_text(json.dumps(record))
    assert open_source(case).content.record == record


@pytest.mark.parametrize("command", ["diagnose", "plan"])
def test_a_case_in_prose_is_refused_with_the_command_to_use(
    case: Path, tmp_path: Path, call: Call, command: str
) -> None:
    (case / "case.yaml").unlink()
    nominal = {"energy": "W = mu/2 (I1bar-3)", "plates": "lower fixed at y=-28, upper at y=28"}
    (case / "case.json").write_text(json.dumps({"id": "small", "nominal": nominal, "scans": {}}))
    for path in (case, case / "case.json"):
        code, _, err = call(command, path)
        assert code == 2
        assert "describes its physics in sentences" in err
        assert "palpate new diagnosis NAME" in err
        assert err.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_a_case_is_echoed_before_anything_runs(case: Path) -> None:
    rows = dict(understood(case))
    assert rows["E_fat"] == "searched from 6 to 15 kPa"
    assert rows["law"] == "neo-Hookean, without fibres"
    assert rows["scan 2"].startswith("pressed_20N.nrrd: 20 N")


def test_new_writes_a_diagnosis_and_an_experiment(call: Call) -> None:
    for kind in ("diagnosis", "experiment"):
        code, out, _ = call("new", kind, f"my-{kind}")
        assert (code, f"palpate diagnose my-{kind}.yaml" in out) == (0, True)
        code, _, err = call("diagnose", f"my-{kind}.yaml")
        assert code == 2
        assert f"my-{kind}.yaml is not finished" in err


@pytest.mark.parametrize("command", ["diagnose", "plan"])
def test_a_study_file_has_to_run_first(command: str, call: Call) -> None:
    call("new", "breast", "mine")
    code, _, err = call(command, "mine.yaml")
    assert code == 2
    assert "study file" in err and "palpate run mine.yaml" in err and "runs/mine" in err
