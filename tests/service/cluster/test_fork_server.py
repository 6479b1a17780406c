"""Workers forked from a process with imports done; each test runs in a new process."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import dask
import pytest

from palpate.service.cluster.worker_startup import METHOD, forked_workers
from tests.service.diagnosis.compressed_breast import write_case

IMPORTS = "palpate.service.diagnosis.worker_imports"


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command in a new session, as in a separate terminal."""
    return subprocess.Popen(
        [sys.executable, "-m", "palpate", *arguments],
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def has_ended(group: int, within_s: float) -> bool:
    """Return True if no process of a group is left; the fork server may finish an import."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def printed(folder: Path, script: str) -> Any:
    """Run a script in a folder and return its output, parsed as JSON."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", textwrap.dedent(script)],  # as in the command `palpate`
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        start_new_session=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_forked_workers_and_their_replacements_have_the_imports(tmp_path: Path) -> None:
    (tmp_path / "storage.py").write_text("raise ValueError('of the user, not ours')")
    found = printed(
        tmp_path,
        f"""
        import json, os, signal, sys
        from palpate.service.cluster.dask_cluster import open_cluster
        from palpate.service.cluster.worker_startup import forked_workers

        def seen():
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
            return {{
                "pid": os.getpid(),
                "imported": {IMPORTS!r} in sys.modules,
                "interrupts": signal.SIGINT not in blocked,
                "threads": os.environ["OMP_NUM_THREADS"],
            }}

        def of_worker(cluster):
            cluster.client.wait_for_workers(1, timeout=60)
            (one,) = cluster.client.run(seen).values()
            return one

        with forked_workers(None, {IMPORTS!r}), open_cluster(workers=1) as cluster:
            first = again = of_worker(cluster)
            os.kill(first["pid"], signal.SIGKILL)
            while again["pid"] == first["pid"]:
                try:
                    again = of_worker(cluster)
                except Exception:  # it is just then that it dies
                    pass
        print(json.dumps([first, again]))
        """,
    )
    for worker in found:
        del worker["pid"]
        assert worker == {"imported": True, "interrupts": False, "threads": "1"}


def test_workers_that_do_not_start_give_one_message(tmp_path: Path) -> None:
    dies = "import os\nos.register_at_fork(after_in_child=lambda: os._exit(1))\n"
    (tmp_path / "dies.py").write_text(dies)
    message = printed(
        tmp_path,
        f"""
        import json, os
        os.environ["PYTHONPATH"] = os.pathsep.join([{str(tmp_path)!r}, *os.sys.path])
        from palpate.service.cluster.dask_cluster import open_cluster
        from palpate.service.errors_and_interrupts import ClusterError
        from palpate.service.cluster.worker_startup import forked_workers

        with forked_workers(None, "dies"):
            try:
                with open_cluster(workers=1):
                    pass
            except ClusterError as error:
                print(json.dumps(str(error)))
        """,
    )
    assert message.startswith("No worker process has started in 3 attempts")


def test_imports_nothing_for_remote_workers() -> None:
    with forked_workers("tcp://10.0.0.5:8786", "no.such.module"):
        assert dask.config.get(METHOD) == "spawn"


@pytest.mark.slow
def test_a_refused_case_leaves_no_process(tmp_path: Path) -> None:
    with started(tmp_path, "diagnose", "nothing") as refused:
        _, said = refused.communicate(timeout=60)
    assert refused.returncode == 2
    assert said.startswith("Error: nothing cannot be diagnosed")
    assert said.count("\n") == 1
    assert has_ended(refused.pid, within_s=30)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "when", ["Understood", pytest.param("measuring distances", marks=pytest.mark.slow)]
)
def test_a_diagnosis_stopped_by_ctrl_c_leaves_no_process(tmp_path: Path, when: str) -> None:
    """As a terminal stops it: all processes get the signal, only the command responds."""
    case = write_case(tmp_path / "case", {})
    with started(tmp_path, "diagnose", str(case), "--workers", "2", "--nodes", "1600") as running:
        assert running.stderr is not None
        while when not in running.stderr.readline():
            assert running.poll() is None
        os.killpg(running.pid, signal.SIGINT)
        said = running.stderr.read()
    assert running.returncode == 130
    assert "Interrupted" in said
    assert "Traceback" not in said
    assert has_ended(running.pid, within_s=30)
