"""`palpate run` as typed by a user: real physics, real processes, interrupted and continued."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from palpate.service.cluster.task_dispatch import SingleProcess
from palpate.service.study.loop import Study
from palpate.service.study.study_keys import read_spec
from tests.recovery.processes import plain_cluster
from tests.recovery.stand_ins import told

STUDY = """
name: small
case:
  reference: {phantom: {preset: 250ml, spacing_mm: 2}}
  mesh: {nodes: 1100}
  load: {force_n: 40}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 4
  generations: 2
seed: 2
"""
PALPATE = [sys.executable, "-m", "palpate"]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(STUDY)
    return tmp_path


def palpate(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*PALPATE, *arguments], cwd=place, capture_output=True, text=True, timeout=120, check=False
    )


def interrupt_and_continue(place: Path) -> None:
    """Run it with separate workers, interrupted by Ctrl-C, and continue."""
    options = ["run", "small.yaml", "--study", "again/small", "--workers", "2"]
    started = subprocess.Popen(
        [*PALPATE, *options],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not told(place / "again" / "small"):  # poll often: six evaluations are quickly done
        assert started.poll() is None, started.communicate()
        time.sleep(0.05)
    os.killpg(started.pid, signal.SIGINT)  # as a terminal does, including the workers
    _, err = started.communicate(timeout=30)
    assert started.returncode == 130
    assert "To continue: palpate run small.yaml --study again/small" in err
    assert "Traceback" not in err
    assert len(told(place / "again" / "small")) < 6
    run_to_the_end(place, *options)


def run_to_the_end(place: Path, *command: str) -> None:
    done = palpate(place, *command, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["stopped"]
    assert found["evaluations"]["done"] + found["evaluations"]["diverged"] == 4 + 2
    assert set(found["per_label"]) >= {"fat", "glandular"}
    store = place / found["store"]
    assert (store / "volumes" / f"{found['best']['digest']}.zarr").is_dir()


@pytest.mark.slow
def test_interrupted_run_matches_a_single_process(place: Path) -> None:
    interrupt_and_continue(place)
    study = Study(read_spec(place / "small.yaml"), place / "runs" / "small")
    study.run(SingleProcess())
    assert told(place / "again" / "small") == told(place / "runs" / "small")


@pytest.mark.slow
def test_run_on_a_scheduler_matches_an_interrupted_local_run(place: Path) -> None:
    with plain_cluster(place, workers=2) as address:
        run_to_the_end(place, "run", "small.yaml", "--scheduler", address)
    assert (place / "runs" / "store" / "volumes").is_dir()
    interrupt_and_continue(place)
    assert told(place / "again" / "small") == told(place / "runs" / "small")
