"""The run time of a study is known even in its first generation."""

import os
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cli import main
from palpate.service.results.results_from_journal import study_results
from palpate.service.study import loop as study_module
from palpate.service.study.loop import Study
from palpate.storage.backends.store_paths import StudyLayout
from tests.recovery.stand_ins import TASKS, Inline, small_spec

HOURS = 3


class Stopped(Exception):  # noqa: N818 - simulates a power cut
    """Raised within the first generation."""


class Interrupting(Inline):
    """A runner that stops after three evaluations."""

    def run(self, task: Any, calls: Any) -> Iterator[Any]:
        for number, ending in enumerate(super().run(task, calls)):
            if number == 3:
                raise Stopped
            yield ending


@pytest.fixture
def interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Provide a study started three hours ago and stopped in its first generation."""

    class Earlier(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime.now(tz) - timedelta(hours=HOURS)

    monkeypatch.setattr(study_module, "datetime", Earlier)
    folder = tmp_path / "runs" / "demo"
    with pytest.raises(Stopped):
        Study(small_spec(), folder, tasks=TASKS).run(Interrupting())  # type: ignore[arg-type]
    return folder


def test_interrupted_study_ends_at_last_record(interrupted: Path) -> None:
    assert study_results(interrupted).wall_s == pytest.approx(HOURS * 3600, abs=60)
    an_hour_ago = (datetime.now(UTC) - timedelta(hours=1)).timestamp()
    os.utime(StudyLayout(interrupted).journal, (an_hour_ago, an_hour_ago))
    assert study_results(interrupted).wall_s == pytest.approx((HOURS - 1) * 3600, abs=60)


def test_a_running_study_runs_until_now(
    interrupted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    an_hour_ago = (datetime.now(UTC) - timedelta(hours=1)).timestamp()
    os.utime(StudyLayout(interrupted).journal, (an_hour_ago, an_hour_ago))
    with Study(small_spec(), interrupted, tasks=TASKS).folder.open():  # type: ignore[arg-type]
        assert study_results(interrupted).wall_s == pytest.approx(HOURS * 3600, abs=60)
        assert main(["status", str(interrupted)]) == 0
    said = capsys.readouterr().out
    assert "3 h 0 min in 1 run" in said
    assert "3 of 12 candidates of the next" in said


def test_status_of_study_in_preparation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = Study(small_spec(), tmp_path / "demo", tasks=TASKS)  # type: ignore[arg-type]
    with study.folder.open() as journal:
        study.folder.begin(journal)
        assert main(["status", str(tmp_path / "demo")]) == 0
    assert "body and target are being prepared" in capsys.readouterr().out
