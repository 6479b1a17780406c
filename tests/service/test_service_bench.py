"""Around the simulations: overhead, memory, idle workers; at small size, and whole when slow."""

from pathlib import Path

import pytest

from service.service_bench import all_rows, busy, soak
from service.sleeping import Durations
from storage.errors import InputError


def test_a_steady_search_keeps_workers_busier_than_a_barrier(tmp_path: Path) -> None:
    durations = Durations(mean_s=0.3, spread=0.9)
    shares = {
        mode: busy(6, 12, 3, durations, tmp_path / mode, mode=mode).busy_share
        for mode in ("barrier", "steady")
    }
    assert 0.2 < shares["barrier"] < shares["steady"] <= 1.0


def test_evaluations_must_fill_generations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a multiple of 200, got 300"):
        soak(300, tmp_path)


@pytest.mark.timeout(900)
@pytest.mark.slow
def test_the_figures_that_are_promised() -> None:
    """Some ten minutes, on a machine where nobody else computes."""
    rows = {row["what"]: row for row in all_rows(20_000)}
    assert rows["soak"]["overhead_ms"] <= 15
    assert abs(rows["soak"]["service_growth"]) <= 0.1
    assert abs(rows["soak"]["scheduler_growth"]) <= 0.1
    assert rows["2 workers, barrier"]["busy_share"] >= 0.9
    for workers in (12, 96):
        idle = [rows[f"{workers} workers, {mode}"]["idle_share"] for mode in ("barrier", "steady")]
        assert idle[1] < idle[0]
