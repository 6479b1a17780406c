"""Clock jumps, which change only the dates in a journal."""

from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.task_dispatch import Ending
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.results.results_from_journal import study_results
from palpate.service.study import loop as study_module
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, told

YEAR = timedelta(days=365)


class StoppedAfter(Inline):
    """A runner that is interrupted after a number of evaluations."""

    def __init__(self, evaluations: int) -> None:
        self.left = evaluations

    def run(
        self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        for ending in super().run(task, calls):
            if not self.left:
                raise Interrupted
            self.left -= 1
            yield ending


def set_clock(monkeypatch: pytest.MonkeyPatch, moment: datetime) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> "Clock":
            return cls.fromtimestamp(moment.timestamp(), tz)

    monkeypatch.setattr(study_module, "datetime", Clock)


@pytest.mark.parametrize("jumps", [(YEAR, -YEAR), (-10 * YEAR, 10 * YEAR)])
def test_study_resumes_after_clock_jumps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jumps: tuple[timedelta, ...]
) -> None:
    calm, folder = tmp_path / "calm" / "demo", tmp_path / "runs" / "demo"
    run(calm, Inline())
    for jump in jumps:
        set_clock(monkeypatch, datetime.now(UTC) + jump)
        with pytest.raises(Interrupted):
            run(folder, StoppedAfter(7))
    set_clock(monkeypatch, datetime.now(UTC))
    run(folder, Inline())
    assert told(folder) == told(calm)
    assert_each_ran_once(folder)
    results = study_results(folder)
    assert results.sessions == 3
    assert 0 <= results.wall_s < 60
