"""A structured case through the commands: written, imported, echoed, and the same diagnosis."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from palpate.storage.values import Tissue, Volume
from palpate.workers.organs.breast.case.files import read_case
from palpate.workers.organs.breast.case.source import ScannedCaseSource
from palpate.workers.tasks.sources import is_plannable, open_planned, open_source, understood
from tests.service.diagnosis.compressed_breast import SCANS, described, write_scan

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def prose(tmp_path: Path) -> Path:
    """A block of fat around glandular tissue, which stands for its scans as well."""
    folder = tmp_path / "prose"
    folder.mkdir()
    values = np.zeros((10, 14, 14), np.uint8)
    values[1:-1, 1:-1, 1:-1] = Tissue.FAT
    values[3:-3, 4:-4, 4:-4] = Tissue.GLANDULAR
    for file in SCANS:
        write_scan(folder / file, Volume(values, (4.0, 4.0, 4.0), (-26.0, -26.0, 0.0)))
    (folder / "case.json").write_text(json.dumps(described()))
    return folder


def test_a_case_in_prose_and_its_import_are_one_case(
    prose: Path, tmp_path: Path, call: Call
) -> None:
    folder = Path(shutil.copytree(prose, tmp_path / "small"))
    before = ScannedCaseSource(read_case(folder)).content
    code, out, err = call("import-case", str(folder))
    assert (code, "Wrote" in out) == (0, True)
    assert "springs of 0.2 kPa/mm along x" in err.replace("\n", " ").replace("  ", " ")
    (folder / "case.json").unlink()
    for path in (folder, folder / "case.yaml"):
        after = ScannedCaseSource(read_case(path)).content
        assert after.record == before.record
        assert {k: v.values.tobytes() for k, v in after.volumes.items()} == {
            k: v.values.tobytes() for k, v in before.volumes.items()
        }
        assert is_plannable(path)
        assert open_planned(path).acquisition.loads == ["8 N", "20 N"]
    code, _, err = call("import-case", str(folder))
    assert (code, "there already" in err) == (2, True)


def test_structured_json_is_read_too(prose: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(prose, tmp_path / "small"))
    record = read_case(folder).file.model_dump(mode="json")
    (folder / "case.json").write_text(json.dumps(record))
    assert open_source(folder).content.record == record


def test_an_import_leaves_nothing_where_a_phrase_is_not_known(
    prose: Path, tmp_path: Path, call: Call
) -> None:
    folder = Path(shutil.copytree(prose, tmp_path / "small"))
    said = json.loads((folder / "case.json").read_text())
    said["nominal"]["energy"] = "Ogden N=3"
    (folder / "case.json").write_text(json.dumps(said))
    for command in (["import-case"], ["diagnose"], ["plan"]):
        code, _, err = call(*command, str(folder))
        assert code == 2
        assert "Ogden N=3" in err
    assert not (folder / "case.yaml").exists()
    assert not (tmp_path / "runs").exists()


def test_a_case_is_echoed_before_anything_runs(prose: Path) -> None:
    rows = dict(understood(prose))
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


def test_import_case_of_something_else_is_refused(tmp_path: Path, call: Call) -> None:
    (tmp_path / "empty").mkdir()
    code, _, err = call("import-case", "empty")
    assert (code, "is no case" in err) == (2, True)
