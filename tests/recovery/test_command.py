"""`palpate run` as a user types it: real physics, real processes, interrupted and continued."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import plain_cluster
from stand_ins import told

STUDY = """
name: small
case:
  reference: {phantom: {preset: 250ml, spacing_mm: 2}}
  mesh: {nodes: 1100}
  load: {force_n: 40}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 6
  generations: 2
seed: 2
"""
PALPATE = [sys.executable, "-m", "service"]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(STUDY)
    return tmp_path


def palpate(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*PALPATE, *arguments], cwd=place, capture_output=True, text=True, timeout=120, check=False
    )


def test_a_run_on_an_existing_scheduler_and_one_interrupted_here_agree(place: Path) -> None:
    with plain_cluster(place, workers=2) as address:
        done = palpate(place, "run", "small.yaml", "--scheduler", address, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["stopped"]
    assert found["evaluations"]["done"] + found["evaluations"]["diverged"] == 6 + 4
    assert set(found["per_label"]) >= {"fat", "glandular"}
    assert (place / "runs" / "store" / "volumes" / f"{found['best']['digest']}.zarr").is_dir()

    # The same study elsewhere, with its own workers and store, stopped by Ctrl-C on the way.
    options = ["run", "small.yaml", "--study", "again/small", "--workers", "2"]
    started = subprocess.Popen(
        [*PALPATE, *options],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not told(place / "again" / "small"):  # soon, for ten evaluations are quickly done
        assert started.poll() is None, started.communicate()
        time.sleep(0.05)
    os.killpg(started.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    _, err = started.communicate(timeout=30)
    assert started.returncode == 130
    assert "To continue: palpate run small.yaml --study again/small" in err
    assert "Traceback" not in err
    assert len(told(place / "again" / "small")) < 10

    assert palpate(place, *options).returncode == 0
    assert told(place / "again" / "small") == told(place / "runs" / "small")
