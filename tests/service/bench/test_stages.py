"""The benchmark of stages: rows, ratios, and their output."""

import json
from pathlib import Path

import pytest

from palpate.service.bench.stage_timing import Bench, Row, _in_processes, _solver, per_unknown
from palpate.service.cli import main
from palpate.service.commands.validation.bench import line
from palpate.service.errors_and_interrupts import TaskError


def test_time_per_unknown_is_relative_to_the_previous_mesh() -> None:
    small = per_unknown(Row("solve", "s", 1000, None, 0.3, 100.0), None)
    assert (small.ratio, small.peak_mb) == (None, None)
    assert small.seconds == pytest.approx(1e-4)
    large = per_unknown(Row("solve", "l", 4000, None, 2.4, 400.0), small)
    assert large.seconds == pytest.approx(2e-4)
    assert large.ratio == pytest.approx(2.0)
    assert large.over == "1000 nodes"


def in_this_process(
    stage: str, spacing_mm: float, nodes: int, store: Path, count: int
) -> list[Row]:
    """Replace processes, each of which takes seconds to start."""
    return [Bench(spacing_mm, nodes, store).run(stage) for _ in range(count)]


@pytest.mark.parametrize(
    "where", ["in this process", pytest.param("in processes", marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_times_the_solver_at_two_sizes(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if where == "in this process":
        monkeypatch.setattr("palpate.service.bench.stage_timing._in_processes", in_this_process)
    rows = list(_solver([1000, 2500], 2.0, tmp_path))
    stages = ["solve", "unknown", "two at once", "one tangent", "ten tangents"]
    assert [row.stage for row in rows] == 2 * stages
    small, large = rows[:5], rows[5:]
    for found in (small, large):
        solve, unknown, _, one, ten = found
        assert solve.nodes is not None
        assert unknown.seconds == solve.seconds / (3 * solve.nodes)
        assert one.ratio == one.seconds / solve.seconds
        assert ten.ratio == ten.seconds / solve.seconds
        assert one.seconds < ten.seconds
    assert large[0].nodes is not None
    assert small[0].nodes is not None
    assert large[0].nodes > 2 * small[0].nodes
    assert large[1].over == f"{small[0].nodes} nodes"


@pytest.mark.slow
def test_concurrent_processes_return_their_rows(tmp_path: Path) -> None:
    first, second = _in_processes("solve", 2.0, 1000, tmp_path, 2)
    for row in (first, second):
        assert (row.stage, row.size) == ("solve", "2 mm, 1000 nodes requested")
        assert row.seconds > 0
        assert row.peak_mb is not None
    assert first.nodes == second.nodes


@pytest.mark.slow
def test_failed_stage_is_named_with_its_size(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"stage solve at 300 nodes and 500\.0 mm failed"):
        list(_solver([300], 500.0, tmp_path))


def test_rows_are_formatted_with_units() -> None:
    row = Row("two at once", "1 mm, 90 nodes requested", 91, 7, 1.5, 256.0, 1.25, "one alone")
    for part in ("two at once", "(91)", "1.5000 s", "256 MB", "1.25 x one alone"):
        assert part in line(row)
    assert "12.34 us" in line(Row("unknown", "s", 91, None, 1.234e-5, None))
    assert line(Row("scheduler", "one task", None, None, 0.002, None)).endswith("0.0020 s")


def test_help_names_the_independent_solver(capsys: pytest.CaptureFixture[str]) -> None:
    main(["bench", "--help"])
    assert "tests.benchmarks.independent" in capsys.readouterr().out


def test_json_output_has_every_row(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [
        Row("solve", "s", 5, None, 0.1, 1.0),
        Row("unknown", "s", 5, None, 0.01, None, 2.0, "x"),
    ]
    monkeypatch.setattr("palpate.service.commands.validation.bench.measure", lambda *_: iter(rows))
    assert main(["bench", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [Row(**row) for row in found] == rows
