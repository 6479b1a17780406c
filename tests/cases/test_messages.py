"""Error messages about workers, scripts and file systems."""

import errno
import fcntl
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.cluster.worker_failures import (
    as_cluster_error,
    explained_imports,
    raise_if_foreign,
    raise_if_store,
)
from palpate.service.cluster.worker_startup import is_unguarded
from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.backends.atomic_files import hint
from palpate.storage.errors import InputError, JournalError, StoreError
from palpate.storage.journal import Journal

BARE_WORKER = '''
import sys
from importlib.abc import MetaPathFinder

class Without(MetaPathFinder):
    """Hides Palpate, as in an environment where it is not installed."""

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "palpate":
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)

sys.meta_path.insert(0, Without())
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
'''


@pytest.mark.slow
def test_error_for_a_worker_without_palpate_advises_installation(tmp_path: Path) -> None:
    script = tmp_path / "bare.py"
    script.write_text(BARE_WORKER)
    command = [sys.executable, str(script)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as bare:
        assert bare.stdin is not None
        assert bare.stdout is not None
        address = bare.stdout.readline().strip()
        expected = r"have no Palpate \(.*\)\. Install Palpate"
        with pytest.raises(ClusterError, match=expected), open_cluster(address):
            pass
        bare.stdin.close()


@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("No module named 'palpate'", name="palpate"),
        ModuleNotFoundError("No module named 'palpate.workers.tasks'"),
        Exception("ModuleNotFoundError(\"No module named 'palpate.service.study.preflight'\")"),
    ],
)
def test_every_form_of_a_missing_palpate_is_recognised(error: Exception) -> None:
    with pytest.raises(ClusterError, match="have no Palpate"):
        raise_if_foreign(error)


@pytest.mark.parametrize(
    "error",
    [
        ImportError(
            "cannot import name 'find' from 'palpate.workers.tasks.study_tasks' (/opt/w.py)"
        ),
        AttributeError(
            "Can't get attribute 'find' on <module 'palpate.workers.tasks' from '/opt'>"
        ),
    ],
)
def test_another_version_of_palpate_is_recognised(error: Exception) -> None:
    with pytest.raises(ClusterError, match="another version of Palpate"):
        raise_if_foreign(error)


def test_missing_palpate_is_recognised_in_the_cause_of_an_error() -> None:
    with pytest.raises(ClusterError, match="have no Palpate"), explained_imports():
        try:
            raise ModuleNotFoundError("No module named 'workers'")
        except ModuleNotFoundError as missing:
            raise RuntimeError("Error during deserialization of the task graph") from missing


def test_other_worker_errors_are_unchanged() -> None:
    for error in (ModuleNotFoundError("No module named 'pandas'"), ValueError("workers")):
        raise_if_foreign(error)
    with (
        pytest.raises(ClusterError, match="scheduler can no longer be reached"),
        as_cluster_error(),
    ):
        raise OSError("connection refused")


def test_rejects_a_script_without_a_main_guard(tmp_path: Path) -> None:
    script = tmp_path / "fit.py"
    script.write_text(
        "from palpate.service.cluster.worker_startup import check_main_guard\n\n"
        "check_main_guard()\n"
    )
    ended = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False
    )
    message = ended.stderr.split("InputError: ")[1]
    assert message.startswith(f"{script}, line 3, starts worker processes outside of a main guard")
    assert 'if __name__ == "__main__":\n        main()' in message


GUARDED = 'def main():\n    run()\n\nif __name__ == "__main__":\n    main()\n'


@pytest.mark.parametrize(
    ("text", "line", "unguarded"),
    [
        ("import palpate\npalpate.run()\n", 2, True),
        ("def main():\n    print(__name__)\n\nmain()\n", 4, True),
        (GUARDED, 5, False),
        (GUARDED.replace("__name__ ==", '"x" and __name__ =='), 5, False),
        ('import sys\nif __name__ != "__main__":\n    sys.exit()\nrun()\n', 4, False),
        ("import multiprocessing\nif not multiprocessing.parent_process():\n    run()\n", 3, False),
        ("with open(\n", 1, False),
    ],
)
def test_rejects_only_scripts_certain_to_run_again(text: str, line: int, unguarded: bool) -> None:
    assert is_unguarded(text, line) is unguarded


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_error_for_a_file_system_without_locks(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fcntl, "flock", _refusing(number))
    path = tmp_path / "journal.jsonl"
    with pytest.raises(JournalError, match=r"cannot be locked: .* has no file locks") as caught:
        Journal(path)
    assert "local disk" in str(caught.value)
    assert "mount it with locks" in str(caught.value)
    assert not Journal.is_being_written(path)  # a finished study can be read there


def _refusing(number: int) -> Callable[..., None]:
    def refuse(handle: int, kind: int) -> None:
        raise OSError(number, "Function not implemented")

    return refuse


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.EMFILE, "Too many files are open"),
        (errno.ENAMETOOLONG, "name is too long"),
        (errno.ESTALE, "mount it again"),
        (errno.EINVAL, "Choose another place"),
    ],
)
def test_failed_writes_have_specific_advice(number: int, advice: str) -> None:
    assert advice in hint(OSError(number, "no"))


def test_read_only_store_is_not_reported_as_full() -> None:
    with pytest.raises(StoreError, match="file system is read-only") as caught:
        raise_if_store(OSError(errno.EROFS, "Read-only file system"))
    assert "Free some" not in str(caught.value)
    with pytest.raises(StoreError, match="disk is full: free some space"):
        raise_if_store(OSError(errno.ENOSPC, "No space left on device"))


@pytest.mark.parametrize("workers", [0, -1])
def test_python_error_names_the_python_argument(workers: Any) -> None:
    with (
        pytest.raises(InputError, match=f"workers={workers}: at least one worker is needed"),
        open_cluster(workers=workers),
    ):
        pass
