"""Progress output of a running study."""

from io import StringIO
from pathlib import Path

from rich.console import Console

from palpate.service.study.study_progress import (
    LiveProgress,
    PlainProgress,
    clock,
    progress_observer,
)
from tests.recovery.stand_ins import Inline, run


def test_log_has_a_line_for_each_generation(tmp_path: Path) -> None:
    text = StringIO()
    progress = progress_observer(Console(file=text, width=200))
    assert isinstance(progress, PlainProgress)
    with progress:
        run(tmp_path / "runs" / "demo", Inline(), observers=[progress])
    lines = text.getvalue().splitlines()
    generations = [line for line in lines if line.startswith("generation ") and " done: " in line]
    assert len(generations) == 5
    assert "best GSF" in generations[0]
    assert (
        f"page: {tmp_path / 'runs' / 'demo' / 'report.html'}, new after every generation" in lines
    )
    assert lines[-1] == "stopped: all 5 generations are done"


def test_terminal_shows_a_live_panel(tmp_path: Path) -> None:
    text = StringIO()
    progress = progress_observer(Console(file=text, width=120, force_terminal=True))
    assert isinstance(progress, LiveProgress)
    with progress:
        run(tmp_path / "runs" / "demo", Inline(), observers=[progress])
    last = dict(progress.rows())
    assert last["generations"] == "5 of at most 5 complete"
    assert "diverged" in last["evaluations"]
    assert "GSF" in last["best so far"]
    assert last["page"].startswith(str(tmp_path / "runs" / "demo" / "report.html"))
    assert "demo" in text.getvalue()


def test_resumed_study_replays_the_same_events(tmp_path: Path) -> None:
    first = PlainProgress(Console(file=StringIO()))
    second = PlainProgress(Console(file=StringIO()))
    run(tmp_path / "runs" / "demo", Inline(), observers=[first])
    run(tmp_path / "runs" / "demo", Inline(), observers=[second])
    assert second.counts == first.counts
    assert second.best == first.best
    assert first.per_minute > 0
    assert second.per_minute == 0


def test_durations_are_formatted_as_text() -> None:
    assert [clock(s) for s in (0, 61, 3600, 90_000, float("inf"))] == [
        "0 s",
        "1 min 1 s",
        "1 h 0 min",
        "1 d 1 h",
        "unknown",
    ]
