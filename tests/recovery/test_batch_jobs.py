"""Workers as jobs, with stand-ins that run a job script as a process of this machine."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import dask
import pytest
import yaml

from palpate.service.cluster import batch_system_workers, dask_cluster
from palpate.service.cluster.batch_system_workers import (
    BatchSystem,
    JobCluster,
    JobRequest,
    check_batch_system,
    open_jobs,
)
from palpate.service.cluster.certificates import make_certificates
from palpate.service.cluster.cluster_choice import WorkerRange
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.task_dispatch import Dispatcher
from palpate.service.errors_and_interrupts import ClusterError
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, set_manners, told

pytest.importorskip("dask_jobqueue", reason="dask-jobqueue is not installed")

# The script is copied: jobqueue removes it as soon as it is submitted. bsub reads it from stdin.
SUBMIT = """#!/bin/sh
number=$$
cat "$@" > {jobs}/$number.sh
setsid {environment} /bin/sh {jobs}/$number.sh > {jobs}/$number.out 2>&1 &
echo $! > {jobs}/$number.pid
echo "{answer}"
"""
CANCEL = """#!/bin/sh
for number in "$@"; do kill -TERM -- -$(cat {jobs}/$number.pid); done
"""
ANSWERS = {
    "sbatch": "Submitted batch job $number",
    "qsub": "$number.server",
    "bsub": "Job <$number> is submitted to default queue <normal>.",
}
# PBS and SGE start a job without the variables of whoever submits it.
ENVIRONMENTS = {"qsub": "env -i PATH=/usr/bin:/bin"}


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The programs of all batch systems first on the PATH; the folder of the submitted jobs."""
    folder, programs = tmp_path / "jobs", tmp_path / "bin"
    folder.mkdir()
    programs.mkdir()
    texts = dict.fromkeys(("scancel", "qdel", "bkill"), CANCEL.format(jobs=folder))
    for name, answer in ANSWERS.items():
        environment = ENVIRONMENTS.get(name, "")
        texts[name] = SUBMIT.format(jobs=folder, environment=environment, answer=answer)
    for name, text in texts.items():
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    here = str(Path(__file__).parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    yield folder
    for pid in folder.glob("*.pid"):
        with suppress(ProcessLookupError, ValueError):
            os.killpg(int(pid.read_text()), signal.SIGKILL)


@pytest.mark.slow
def test_a_study_on_jobs_of_slurm(jobs: Path, tmp_path: Path) -> None:
    run(tmp_path / "here" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    request = JobRequest(
        "slurm",
        workers=2,
        memory="1GB",
        queue="short",
        options=("--exclusive",),
        setup=("echo module load python",),
        host="127.0.0.1",
    )
    with open_jobs(request) as cluster:
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


def until_up(cluster: JobCluster, workers: int) -> None:
    deadline = time.monotonic() + 60
    while (alive := cluster.running) != workers:
        assert time.monotonic() < deadline, f"{alive} workers"
        time.sleep(0.05)


def test_a_job_that_slurm_ends_is_submitted_again(
    jobs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_system_workers, "LOOK_EVERY_S", 0.1)
    monkeypatch.setattr(batch_system_workers, "GONE_S", 0.5)
    with open_jobs(JobRequest("slurm", workers=1, memory="1GB", host="127.0.0.1")) as cluster:
        cluster.submit()
        until_up(cluster, 1)
        time.sleep(1.0)  # ten looks: a worker that nobody saw is not missed
        (ended,) = jobs.glob("*.pid")
        os.killpg(int(ended.read_text()), signal.SIGKILL)
        until_up(cluster, 0)
        until_up(cluster, 1)
        assert len(list(jobs.glob("*.sh"))) == 2


@pytest.mark.slow
def test_jobs_follow_the_work(jobs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "ADAPT_EVERY_S", 0.1)
    monkeypatch.setattr(dask_cluster, "IDLE_S", 1.0)
    run(tmp_path / "here" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    set_manners(tmp_path / "runs" / "store", held_after=0)

    def release() -> None:
        try:
            until_up(cluster, 2)
        finally:
            set_manners(tmp_path / "runs" / "store")

    with open_jobs(
        JobRequest("slurm", workers=WorkerRange(1, 2), memory="1GB", host="127.0.0.1")
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


HEADERS: dict[BatchSystem, tuple[str, ...]] = {
    "slurm": ("#SBATCH -p long", "#SBATCH -A lab", "#SBATCH --mem=2G", "#SBATCH -t 12:30:00"),
    "pbs": (
        "#PBS -q long",
        "#PBS -A lab",
        "#PBS -l select=1:ncpus=1:mem=2048MB",
        "#PBS -l walltime=12:30:00",
    ),
    "lsf": ("#BSUB -q long", '#BSUB -P "lab"', "#BSUB -n 1", "#BSUB -W 12:30"),
    "sge": ("#$ -q long", "#$ -P lab", "#$ -l h_rt=12:30:00"),
}
SIGNS = {"slurm": "#SBATCH", "pbs": "#PBS", "lsf": "#BSUB", "sge": "#$"}


@pytest.mark.parametrize("system", HEADERS)
def test_job_script_of_each_batch_system(system: BatchSystem, tmp_path: Path) -> None:
    request = JobRequest(
        system,
        workers=1,
        memory="2GiB",
        walltime="12:30:00",
        queue="long",
        account="lab",
        options=("-V",),
        host="127.0.0.1",
        logs=tmp_path / "logs",
    )
    with open_jobs(request) as cluster:
        lines = cluster.script.splitlines()
    for line in (*HEADERS[system], f"{SIGNS[system]} -V", "export OMP_NUM_THREADS='1'"):
        assert line in lines, cluster.script
    assert any(str(tmp_path / "logs") in line for line in lines)
    assert f"dask_worker {cluster.address} " in cluster.script
    assert "--tls" not in cluster.script


@pytest.mark.parametrize("system", ["pbs", pytest.param("lsf", marks=pytest.mark.slow)])
def test_a_job_with_certificates_comes_up_and_is_cancelled(
    system: BatchSystem, jobs: Path, tmp_path: Path
) -> None:
    made = make_certificates(tmp_path / "tls")
    configured = dask.config.merge(dask.config.config, yaml.safe_load(made.as_yaml()))
    with dask.config.set(configured):
        with open_jobs(JobRequest(system, workers=1, host="127.0.0.1")) as cluster:
            assert cluster.address.startswith("tls://")
            assert f"--tls-cert {made.folder / 'worker.pem'}" in cluster.script
            cluster.submit()
            until_up(cluster, 1)
        (submitted,) = jobs.glob("*.pid")
        until_ended(int(submitted.read_text()))


def until_ended(pid: int) -> None:
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            os.killpg(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError(f"job {pid} still runs")


def test_certificates_that_cannot_be_read_are_named() -> None:
    paths = {f"distributed.comm.tls.scheduler.{key}": "/nowhere/one" for key in ("cert", "key")}
    with (
        dask.config.set({"distributed.comm.tls.ca-file": "/nowhere/ca.pem"} | paths),
        pytest.raises(ClusterError, match="A certificate cannot be read"),
        open_jobs(JobRequest("sge", workers=1)),
    ):
        pass


@pytest.mark.parametrize(("system", "program"), [("slurm", "sbatch"), ("lsf", "bsub")])
def test_without_the_batch_system_there_is_one_message(
    system: BatchSystem, program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ClusterError, match=f"There is no {program} on this machine"):
        check_batch_system(system)


def test_dry_run_prints_the_script_and_submits_nothing(jobs: Path) -> None:
    command = "cluster pbs --workers 3 --dry-run --host 127.0.0.1"
    done = subprocess.run(
        [sys.executable, "-m", "palpate", *command.split()],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "#PBS -N palpate" in done.stdout
    assert "is not encrypted" in done.stderr
    assert not list(jobs.glob("*.sh"))
