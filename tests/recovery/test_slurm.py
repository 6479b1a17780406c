"""Workers as jobs of SLURM, with a stand-in that runs the script as a process of this machine."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from palpate.service.cluster import adaptive, slurm
from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.cluster.open import open_cluster
from palpate.service.cluster.slurm import SlurmCluster, SlurmRequest, open_slurm
from palpate.service.cluster.worker_range import WorkerRange
from palpate.service.errors import ClusterError
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, set_manners, told

pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")

# The script is copied: jobqueue removes it as soon as it is submitted.
SBATCH = """#!/bin/sh
number=$$
cp "$1" {jobs}/$number.sh
setsid /bin/sh {jobs}/$number.sh > {jobs}/$number.out 2>&1 &
echo $! > {jobs}/$number.pid
echo "Submitted batch job $number"
"""
SCANCEL = """#!/bin/sh
for number in "$@"; do kill -TERM -- -$(cat {jobs}/$number.pid); done
"""


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """SLURM's programs first on the PATH; the folder of the jobs that are submitted."""
    folder, programs = tmp_path / "jobs", tmp_path / "bin"
    folder.mkdir()
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (programs / name).write_text(text.format(jobs=folder))
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    here = str(Path(__file__).parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    yield folder
    for pid in folder.glob("*.pid"):
        with suppress(ProcessLookupError, ValueError):
            os.killpg(int(pid.read_text()), signal.SIGKILL)


def test_a_study_on_jobs_of_slurm(jobs: Path, tmp_path: Path) -> None:
    run(tmp_path / "here" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    request = SlurmRequest(
        workers=2,
        memory="1GB",
        queue="short",
        options=("--exclusive",),
        setup=("echo module load python",),
        host="127.0.0.1",
    )
    with open_slurm(request) as cluster:
        assert not list(jobs.glob("*.sh"))  # shown before it is submitted
        for line in (
            "#SBATCH -p short",
            "#SBATCH --exclusive",
            "#SBATCH --cpus-per-task=1",
            "#SBATCH --mem=954M",
            "#SBATCH -t 24:00:00",
            "echo module load python",
            "export OMP_NUM_THREADS='1'",
            "export DASK_DISTRIBUTED__WORKER__MEMORY__SPILL='False'",
        ):
            assert line in cluster.script.splitlines(), cluster.script
        assert "--nthreads 1" in cluster.script
        cluster.submit()
        with open_cluster(cluster.address) as opened:
            run(folder, Dispatcher(opened.client))
    submitted = [script.read_text() for script in jobs.glob("*.sh")]
    assert len(submitted) == 2
    assert told(folder) == told(tmp_path / "here" / "demo")
    assert_each_ran_once(folder)


def until_up(cluster: SlurmCluster, workers: int) -> None:
    deadline = time.monotonic() + 60
    while (alive := cluster.running) != workers:
        assert time.monotonic() < deadline, f"{alive} workers"
        time.sleep(0.05)


def test_a_job_that_slurm_ends_is_submitted_again(
    jobs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slurm, "LOOK_EVERY_S", 0.1)
    monkeypatch.setattr(slurm, "GONE_S", 0.5)
    with open_slurm(SlurmRequest(workers=1, memory="1GB", host="127.0.0.1")) as cluster:
        cluster.submit()
        until_up(cluster, 1)
        time.sleep(1.0)  # ten looks: a worker that nobody saw is not missed
        (ended,) = jobs.glob("*.pid")
        os.killpg(int(ended.read_text()), signal.SIGKILL)
        until_up(cluster, 0)
        until_up(cluster, 1)
        assert len(list(jobs.glob("*.sh"))) == 2


def test_jobs_follow_the_work(jobs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adaptive, "ADAPT_EVERY_S", 0.1)
    monkeypatch.setattr(adaptive, "IDLE_S", 1.0)
    run(tmp_path / "here" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    set_manners(tmp_path / "runs" / "store", held_after=0)

    def release() -> None:
        try:
            until_up(cluster, 2)
        finally:
            set_manners(tmp_path / "runs" / "store")

    with open_slurm(
        SlurmRequest(workers=WorkerRange(1, 2), memory="1GB", host="127.0.0.1")
    ) as cluster:
        cluster.submit()
        until_up(cluster, 1)
        releasing = threading.Thread(target=release)
        releasing.start()
        with open_cluster(cluster.address) as opened:
            run(folder, Dispatcher(opened.client))
        releasing.join()
        assert len(list(jobs.glob("*.sh"))) >= 2
        until_up(cluster, 1)
    assert told(folder) == told(tmp_path / "here" / "demo")
    assert_each_ran_once(folder)


def test_without_slurm_there_is_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with (
        pytest.raises(ClusterError, match="There is no sbatch on this machine"),
        open_slurm(SlurmRequest(workers=1)),
    ):
        pass


def test_the_command_shows_the_script_and_submits_nothing(jobs: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "palpate",
            "slurm",
            "--workers",
            "3",
            "--show",
            "--host",
            "127.0.0.1",
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "#SBATCH -J palpate" in done.stdout
    assert not list(jobs.glob("*.sh"))
