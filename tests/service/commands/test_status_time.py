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
from palpate.service.study.study_archive import export_study, import_study
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.journal import Journal
from palpate.storage.json_digests import dumps, seal
from tests.recovery.stand_ins import SPEC, TASKS, Inline, rewrite, run, small_spec

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


def interrupt(folder: Path, monkeypatch: pytest.MonkeyPatch, spec: StudySpec) -> Path:
    """Start a study three hours ago and stop it in its first generation."""

    class Earlier(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime.now(tz) - timedelta(hours=HOURS)

    monkeypatch.setattr(study_module, "datetime", Earlier)
    with pytest.raises(Stopped):
        Study(spec, folder, tasks=TASKS).run(Interrupting())  # type: ignore[arg-type]
    return folder


@pytest.fixture
def interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Provide a study started three hours ago and stopped in its first generation."""
    return interrupt(tmp_path / "runs" / "demo", monkeypatch, small_spec())


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


def wall_h(folder: Path) -> float:
    return study_results(folder).wall_s / 3600


def set_last_sign(folder: Path, hours_ago: float) -> None:
    moment = (datetime.now(UTC) - timedelta(hours=hours_ago)).timestamp()
    os.utime(StudyLayout(folder).journal, (moment, moment))


@pytest.mark.parametrize("tail", [b"", b'{"kind":"evalu'], ids=["whole", "torn"])
def test_time_of_a_killed_run_stays_when_the_study_continues(
    interrupted: Path, monkeypatch: pytest.MonkeyPatch, tail: bytes
) -> None:
    with StudyLayout(interrupted).journal.open("ab") as file:
        file.write(tail)
    set_last_sign(interrupted, hours_ago=1)
    assert wall_h(interrupted) == pytest.approx(HOURS - 1, abs=0.02)
    study = Study(small_spec(), interrupted, tasks=TASKS)
    study.folder.open().close()  # killed again, before it could write anything
    assert wall_h(interrupted) == pytest.approx(HOURS - 1, abs=0.02)
    monkeypatch.setattr(study_module, "datetime", datetime)
    with pytest.raises(Stopped):
        Study(small_spec(), interrupted, tasks=TASKS).run(Interrupting())
    assert wall_h(interrupted) == pytest.approx(HOURS - 1, abs=0.02)
    run(interrupted, Inline())
    results = study_results(interrupted)
    assert results.wall_s / 3600 == pytest.approx(HOURS - 1, abs=0.02)
    assert (results.state, results.sessions) == ("stopped", 3)


def test_time_of_a_killed_run_counts_towards_the_time_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = small_spec(SPEC.replace("  generations: 5", "  generations: 5\n  stop: {hours: 2}"))
    folder = interrupt(tmp_path / "runs" / "demo", monkeypatch, spec)
    monkeypatch.setattr(study_module, "datetime", datetime)
    run(folder, Inline(), spec)
    results = study_results(folder)
    assert results.stop_reason is not None
    assert "search.stop.hours (2 h) has been reached" in results.stop_reason
    assert len(results.complete_generations) == 1


def test_time_of_a_killed_run_moves_with_its_study(interrupted: Path, tmp_path: Path) -> None:
    set_last_sign(interrupted, hours_ago=1)
    export_study(interrupted, tmp_path / "demo.tar")
    moved = tmp_path / "moved" / "demo"
    import_study(tmp_path / "demo.tar", moved, tmp_path / "moved" / "store")
    assert wall_h(moved) == pytest.approx(HOURS - 1, abs=0.02)
    run(moved, Inline())
    assert wall_h(moved) == pytest.approx(HOURS - 1, abs=0.02)


@pytest.mark.parametrize("shown", ["without a zone", "not a time"])
def test_a_beginning_without_a_zone_is_in_utc(
    interrupted: Path, capsys: pytest.CaptureFixture[str], shown: str
) -> None:
    journal = StudyLayout(interrupted).journal
    records = list(Journal.read(journal))
    session = next(record for record in records if record["kind"] == "session")
    began = str(session["began"]).removesuffix("+00:00")
    session["began"] = began if shown == "without a zone" else "on Monday"
    rewrite(journal, records)
    set_last_sign(interrupted, hours_ago=1)
    assert main(["status", str(interrupted)]) == 0
    time = "2 h 0 min" if shown == "without a zone" else "0 s"
    assert f"{time} in 1 run" in capsys.readouterr().out


def test_status_counts_records_written_before_chained_seals(
    interrupted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = StudyLayout(interrupted).journal
    records = list(Journal.read(journal))
    journal.write_text("".join(seal(dumps(record)) + "\n" for record in records))
    assert main(["status", str(interrupted)]) == 0
    said = capsys.readouterr().out
    assert f"{len(records)} written before chained seals: a record taken out is not noticed" in said


def test_status_of_study_in_preparation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = Study(small_spec(), tmp_path / "demo", tasks=TASKS)  # type: ignore[arg-type]
    with study.folder.open() as journal:
        study.folder.begin(journal)
        assert main(["status", str(tmp_path / "demo")]) == 0
    assert "body and target are being prepared" in capsys.readouterr().out
