"""Progress of a batch without a terminal."""

import io

import pytest
from rich.console import Console

from palpate.service.cluster.task_dispatch import SingleProcess
from palpate.service.simulation import candidate_batch
from palpate.service.simulation.candidate_batch import BatchProgress, evaluate_batch, plan_batch
from tests.recovery.stand_ins import TASKS, small_spec


def test_lines_count_completed_candidates(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(candidate_batch, "LINE_EVERY_S", 0.0)
    folder = tmp_path_factory.mktemp("runs") / "demo"
    table = {"E_fat_kpa": [6, 8, 12, 8], "E_glandular_kpa": [20, 40, 78, 40]}
    text = io.StringIO()
    with BatchProgress(Console(file=text, width=200)) as shown:
        plan = plan_batch(small_spec(), table, folder)
        evaluate_batch(plan, SingleProcess(), observers=[shown], tasks=TASKS)
    lines = text.getvalue().splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("1 of 4 candidates")
    assert lines[-1].startswith("4 of 4 candidates; 1 diverged; 1 reused")
    assert "per minute on 1 worker" in lines[-1]
