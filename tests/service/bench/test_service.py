"""Benchmarks around the simulations: overhead, memory, idle workers; full size when slow."""

from pathlib import Path
from typing import Any

import pytest

from palpate.service.bench.service_overhead import all_rows, busy, soak
from palpate.service.bench.sleeping_tasks import TASKS, Durations, text_of
from palpate.service.study.loop import Study
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import parse_spec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import Inline


@pytest.mark.parametrize("mode", ["barrier", "steady"])
def test_a_busy_share_is_part_of_the_time(mode: str, tmp_path: Path) -> None:
    durations = Durations(mean_s=0.3, spread=0.9)
    assert 0.2 < busy(6, 12, 3, durations, tmp_path / mode, mode=mode).busy_share <= 1.0


@pytest.mark.slow
def test_a_steady_search_keeps_workers_busier_than_a_barrier(tmp_path: Path) -> None:
    """Only on a machine without other load, which delays single tasks."""
    durations = Durations(mean_s=0.3, spread=0.9)
    shares = {
        mode: busy(6, 12, 3, durations, tmp_path / mode, mode=mode).busy_share
        for mode in ("barrier", "steady")
    }
    assert shares["barrier"] < shares["steady"]


def test_sleeping_tasks_work_with_a_bucket(bucket: str, tmp_path: Path) -> None:
    place = f"{bucket}/store"
    Durations(mean_s=0.002, spread=0.5).write(place)
    spec = parse_spec(text_of("bench", 6, 2), "the test's study", Path())
    dispatcher: Any = Inline()
    Study(spec, tmp_path / "bench", place, tasks=TASKS).run(dispatcher)
    endings = StudyLog.read(StudyLayout(tmp_path / "bench").journal).endings.values()
    slept = [record.seconds["sleep"] for record in endings]
    assert len(slept) >= 6
    assert all(0.001 <= seconds <= 0.003 for seconds in slept)
    assert not (tmp_path / "store").exists()


def test_rejects_evaluations_that_do_not_fill_generations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a multiple of 200, got 300"):
        soak(300, tmp_path)


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_published_figures_are_reproduced() -> None:
    """Takes about ten minutes, on a machine without other load."""
    rows = {row["what"]: row for row in all_rows(20_000)}
    assert rows["soak"]["overhead_ms"] <= 15
    assert abs(rows["soak"]["service_growth"]) <= 0.1
    assert abs(rows["soak"]["scheduler_growth"]) <= 0.1
    assert rows["2 workers, barrier"]["busy_share"] >= 0.9
    for workers in (12, 96):
        idle = [rows[f"{workers} workers, {mode}"]["idle_share"] for mode in ("barrier", "steady")]
        assert idle[1] < idle[0]
