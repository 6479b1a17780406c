"""The processes of a compose file: a scheduler, workers, and drivers that are killed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.recovery.processes import kill_and_finish, plain_cluster
from tests.recovery.stand_ins import Inline, executions, run, told


@pytest.mark.slow
def test_drivers_are_killed_while_the_scheduler_runs(tmp_path: Path) -> None:
    run(tmp_path / "undisturbed" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    with plain_cluster(tmp_path, workers=2) as address:
        kill_and_finish(folder, ["--scheduler", address], killed_after=[2, 23])
        doctor = subprocess.run(
            [sys.executable, "-m", "palpate", "doctor", "--scheduler", address, "--json"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
    assert told(folder) == told(tmp_path / "undisturbed" / "demo")
    # A worker outlives its driver and may finish a task that the next driver has requested again:
    # at most one running evaluation on each worker for each kill.
    ran = executions(folder)
    assert len(ran) - len(set(ran)) <= 2 * 2

    found = json.loads(doctor.stdout)
    assert found["problems"] == []
    assert sum(role.startswith("worker") for role in found["processes"]) == 2
