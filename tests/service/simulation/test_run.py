"""Batches equal studies exactly and survive interruptions."""

import csv
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
import palpate.service.simulation.candidate_batch as batch_run
import palpate.service.study.study_session as session_module
from palpate.service.cli import main
from palpate.service.cluster.task_dispatch import SingleProcess
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.simulation.candidate_batch import evaluate_batch, plan_batch
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_session import Session
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.journal_records import Status
from tests.recovery.stand_ins import SPEC, TASKS, executions, run, set_manners, small_spec

TABLE = {"E_fat_kpa": [6.0, 8.0, 12.0, 8.0], "E_glandular_kpa": [20.0, 40.0, 78.0, 40.0]}


class Stopped(SingleProcess):
    """A runner that is asked to stop after some endings."""

    def __init__(self, after: int) -> None:
        self.left = after

    def run(self, task: Any, calls: Any) -> Iterator[Any]:
        for ending in super().run(task, calls):
            if self.left == 0:
                raise Interrupted
            self.left -= 1
            yield ending


def evaluate(folder: Path, table: Any, runner: SingleProcess | None = None) -> palpate.Evaluations:
    plan = plan_batch(small_spec(), table, folder)
    return evaluate_batch(plan, runner or SingleProcess(), tasks=TASKS)


def without_times(found: palpate.Evaluations) -> list[Any]:
    return [(r.genes, r.status, r.score, r.reason, r.digest) for r in found.records]


def test_rows_are_in_order_with_failures_among_them(tmp_path: Path) -> None:
    found = evaluate(tmp_path / "runs" / "demo", TABLE)
    assert found["E_fat_kpa"].tolist() == TABLE["E_fat_kpa"]
    assert found["status"].tolist() == ["done", "done", "diverged", "done"]
    assert found["reason"].tolist() == ["", "", "no equilibrium at 60 N", ""]
    assert math.isnan(found["gsf"][2])
    assert found["gsf"][1] == found["gsf"][3]
    assert found["reused"].tolist() == [False, False, False, True]  # equal rows share one
    assert len(executions(tmp_path / "runs" / "demo")) == 3
    assert found.best is not None
    assert found.best.candidate == 1
    assert len(repr(found)) < 200


def test_batch_equals_study_exactly(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    run(folder, SingleProcess())
    endings = StudyLog.read(StudyLayout(folder).journal).endings.values()
    before = executions(folder)
    again = evaluate(folder, [r.genes for r in endings])
    assert again["reused"].all()
    assert executions(folder) == before
    elsewhere = evaluate(tmp_path / "other" / "demo", [r.genes for r in endings])
    for found in (again, elsewhere):
        for own, record in zip(endings, found.records, strict=True):
            assert (own.digest, own.status, own.score) == (
                record.digest,
                record.status,
                record.score,
            )


@pytest.mark.parametrize("after", [0, 1, 7])
def test_interrupted_batch_equals_uninterrupted_one(tmp_path: Path, after: int) -> None:
    table = small_spec().search.space
    points = np.linspace(table.lower, table.upper, 12)
    columns = dict(zip(table.names, points.T, strict=True))
    calm = evaluate(tmp_path / "calm" / "demo", columns)
    folder = tmp_path / "cut" / "demo"
    with pytest.raises(Interrupted):
        evaluate(folder, columns, Stopped(after))
    done = len(executions(folder))
    assert done >= after
    found = evaluate(folder, columns)
    assert without_times(found) == without_times(calm)
    assert found["reused"].sum() == done
    assert len(executions(folder)) == len(executions(tmp_path / "calm" / "demo"))


def test_crash_is_recorded_and_retried(tmp_path: Path) -> None:
    folder = tmp_path / "runs" / "demo"
    set_manners(folder.parent / "store", crash_above=0.011)
    found = evaluate(folder, TABLE)
    assert found.records[2].status is Status.CRASHED
    assert "no such tissue" in found["reason"][2]
    set_manners(folder.parent / "store")
    assert evaluate(folder, TABLE).records[2].status is Status.DIVERGED


def test_the_table_is_written_and_read_back(tmp_path: Path) -> None:
    found = evaluate(tmp_path / "runs" / "demo", TABLE)
    lines = list(csv.DictReader(found.save(tmp_path / "scores.csv").read_text().splitlines()))
    assert [float(line["gsf"]) for line in lines if line["gsf"] != "nan"] == [
        value for value in found["gsf"].tolist() if not math.isnan(value)
    ]
    assert [line["status"] for line in lines] == found["status"].tolist()
    with pytest.raises(palpate.InputError, match=r"\.xlsx is not supported"):
        found.save(tmp_path / "scores.xlsx")


# The command


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Provide a folder with a study of trivial tasks in this process."""

    @contextmanager
    def here(*arguments: Any) -> Iterator[Session[SingleProcess]]:
        yield Session(SingleProcess())

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(session_module, "session", here)
    monkeypatch.setattr(batch_run, "evaluate_batch", partial(evaluate_batch, tasks=TASKS))
    Path("study.yaml").write_text(SPEC)
    return tmp_path


def test_the_command_writes_a_table(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("table.csv").write_text("E_fat_kpa,E_glandular_kpa\n8,40\n12,78\n")
    assert main(["evaluate", "table.csv", "study.yaml", "--out", "scores.csv"]) == 0
    out = capsys.readouterr().out
    assert "2 candidates: 1 done, 1 diverged" in out
    assert "best: row 1" in out
    assert main(["evaluate", "table.csv", "study.yaml", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["reused"] for row in rows] == [True, True]
    written = list(csv.DictReader(Path("scores.csv").read_text().splitlines()))
    assert rows[0]["gsf"] == float(written[0]["gsf"])


def test_command_evaluates_design(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["evaluate", "study.yaml", "--design", "sobol", "--n", "8", "--seed", "3", "--json"]
    assert main(options) == 0
    rows = json.loads(capsys.readouterr().out)
    columns = palpate.Study.from_file("study.yaml").design(8, "sobol", seed=3)
    for name, values in columns.items():
        assert [row[name] for row in rows] == values.tolist()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["table.csv", "study.yaml"], "Row 2: E_fat_kpa must be above 0 kPa"),
        (["study.yaml"], "Give a table and a study"),
        (["table.csv", "study.yaml", "--design", "sobol"], "give only the study"),
        (["study.yaml", "--design", "sobel"], "no design 'sobel'"),
        (["table.csv", "study.yaml", "--out", "scores.xlsx"], ".xlsx is not supported"),
    ],
)
def test_command_rejects_invalid_input_before_work_starts(
    place: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    Path("table.csv").write_text("E_fat_kpa\n8\n-1\n")
    assert main(["evaluate", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not Path("runs").exists()
