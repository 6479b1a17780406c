"""Defaults of options, logs and hints of commands."""

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cli import main
from palpate.service.cluster.cluster_choice import (
    WorkerRange,
    check_reachable,
    host_and_port,
    read_workers,
)
from palpate.service.cluster.dask_cluster import Cluster
from palpate.service.cluster.task_dispatch import Ending
from palpate.service.commands.command_line import cluster_options, store_place
from palpate.service.errors_and_interrupts import ClusterError
from palpate.service.study import loop as study_module
from palpate.service.study import study_session as session_module
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import SPEC, TASKS, Inline, run, set_manners


def test_option_overrides_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cluster_options(None, None) == (None, None)
    monkeypatch.setenv("PALPATE_WORKERS", "1-3")
    assert cluster_options(None, None) == (None, WorkerRange(1, 3))
    monkeypatch.setenv("PALPATE_WORKERS", "3")
    assert cluster_options(None, None) == (None, 3)
    monkeypatch.setenv("PALPATE_SCHEDULER", "tcp://host:8786")
    assert cluster_options(None, None) == ("tcp://host:8786", None)
    assert cluster_options(None, "2") == (None, 2)
    assert cluster_options(None, "2-2") == (None, 2)
    assert cluster_options(None, "2-8") == (None, WorkerRange(2, 8))
    assert cluster_options("tcp://other:1", None) == ("tcp://other:1", None)
    with pytest.raises(InputError, match="give one of them"):
        cluster_options("tcp://other:1", "2-8")
    monkeypatch.setenv("PALPATE_WORKERS", "4-1")
    monkeypatch.delenv("PALPATE_SCHEDULER")
    with pytest.raises(InputError, match="PALPATE_WORKERS=4-1: give the smaller number first: 1-4"):
        cluster_options(None, None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0", "at least 1"),
        ("0-4", "at least 1"),
        ("4-1", "first: 1-4"),
        *((text, "expected a number") for text in ("a-b", "", "1-", "-4", "1-4-8", "2.5", "4 2")),
    ],
)
def test_rejects_invalid_number_of_workers(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_workers(text)


def test_option_and_environment_select_the_store(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert store_place(None) == Path("runs/store").absolute()
    monkeypatch.setenv("PALPATE_STORE", str(tmp_path / "mine"))
    assert store_place(None) == tmp_path / "mine"
    assert store_place("here") == Path("here").absolute()
    assert str(store_place("s3://lab-7/palpate")) == "s3://lab-7/palpate"
    monkeypatch.chdir(tmp_path)
    assert main(["phantom", "--spacing-mm", "2"]) == 0
    assert (tmp_path / "mine" / "palpate-store.json").exists()


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("tcp://10.0.0.5:8786", ("10.0.0.5", 8786)),
        ("host:8786", ("host", 8786)),
        ("tls://[::1]:1", ("::1", 1)),
    ],
)
def test_scheduler_addresses_are_parsed(address: str, expected: tuple[str, int]) -> None:
    assert host_and_port(address) == expected


@pytest.mark.parametrize(
    "address", ["foo", "", "tcp://foo", "http://foo:8787", "tcp://foo:0", "foo:99999", "a b:1"]
)
def test_rejects_invalid_address_without_connecting(address: str) -> None:
    with pytest.raises(ClusterError, match="invalid address"):
        host_and_port(address)


def test_unknown_host_fails_immediately() -> None:
    with pytest.raises(ClusterError, match="is unknown"):
        check_reachable("tcp://no.such.host.invalid:8786", patience_s=60.0)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_can_complete_commands(shell: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "palpate"],
        env={"_PALPATE_COMPLETE": f"complete_{shell}", "PATH": "/usr/bin"}
        | {"COMP_WORDS": "palpate sim", "COMP_CWORD": "1"}
        | {"_TYPER_COMPLETE_ARGS": "palpate sim", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "simulate" in done.stdout
    assert done.stderr == ""


# --- the log, and how to continue -------------------------------------------------------


class Crashing(Inline):
    """A task that fails like one on a worker."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def run(self, task: Any, calls: Any) -> Any:
        for key, arguments in calls:
            try:
                yield Ending(key, "returned", task(*arguments))
            except ZeroDivisionError as error:
                reason = f"ZeroDivisionError: {error}"
                yield Ending(key, "crashed", None, error, reason, "the traceback of a worker")


@pytest.fixture
def without_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make `palpate run` use arithmetic stand-ins in this process."""
    from contextlib import contextmanager

    @contextmanager
    def no_cluster(*_: Any) -> Any:
        yield Cluster(None, "", True)  # type: ignore[arg-type]

    monkeypatch.setattr(session_module, "open_cluster", no_cluster)
    monkeypatch.setattr(session_module, "Dispatcher", Crashing)
    monkeypatch.setattr(study_module, "Tasks", lambda: TASKS)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text(SPEC)
    return tmp_path


def test_a_run_keeps_a_log_with_times_and_tracebacks(without_cluster: Path) -> None:
    set_manners(without_cluster / "runs" / "store", crash_above=0.017)
    assert main(["run", "study.yaml"]) == 0
    log = (without_cluster / "runs" / "demo" / "palpate.log").read_text()
    assert "generation 5 done: best GSF" in log
    assert "crashed: ZeroDivisionError" in log
    assert "the traceback of a worker" in log
    assert "stopped: " in log
    assert log[:2] == "20"


def test_study_with_only_crashes_gives_exit_code_2(
    without_cluster: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    set_manners(without_cluster / "runs" / "store", crash_above=0.0)
    assert main(["run", "study.yaml"]) == 2
    said = capsys.readouterr().err
    log = StudyLayout(without_cluster / "runs" / "demo").log
    assert "All 12 candidates of generation 1 have crashed for the same reason" in said
    assert str(log) in said
    assert "Traceback" not in said
    assert "the traceback of a worker" in log.read_text()
    set_manners(without_cluster / "runs" / "store")
    assert main(["run", "study.yaml"]) == 0


def test_runs_without_writable_log(without_cluster: Path) -> None:
    (without_cluster / "runs" / "demo" / "palpate.log").mkdir(parents=True)
    assert main(["run", "study.yaml"]) == 0


def test_interrupt_hint_repeats_options_with_quoting(
    without_cluster: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(Crashing, "run", interrupt)
    (without_cluster / "my study.yaml").write_text(SPEC)
    options = ["--scheduler", "tcp://127.0.0.1:1", "--store", "a store", "--study", "here"]
    assert main(["run", "my study.yaml", *options]) == 130
    again = (
        "To continue: palpate run 'my study.yaml' --scheduler tcp://127.0.0.1:1 "
        "--store 'a store' --study here"
    )
    assert again in capsys.readouterr().err


def test_shows_failures_of_study_in_other_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "my runs" / "demo"
    run(folder, Inline())
    monkeypatch.chdir(tmp_path)
    assert main(["status", "my runs/demo"]) == 0
    said = capsys.readouterr().out
    hint = said[said.index("palpate show ") :].splitlines()[0]
    assert f" '{folder}' " in hint
    assert main(shlex.split(hint)[1:]) == 0


def test_reports_only_ratios_for_known_plate_distance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import json

    from tests.recovery.stand_ins import small_spec

    text = SPEC.replace("mesh:", "load: {plate_distance_mm: {final: 60}}, mesh:")
    text = text.replace("E_fat_kpa: [5, 20],", "E_fat_kpa: [5, 20], eta_fat_kpa: [50, 200],")
    text = text.replace("[5, 80]}", "[5, 80], eta_glandular_kpa: [50, 200]}")
    folder = tmp_path / "demo"
    run(folder, Inline(), small_spec(text))
    assert main(["report", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["identifiable"] == "ratio"
    estimates = found["estimates"]
    ratio = found["ratios"]["E_glandular / E_fat"]
    assert ratio["target"] == 4.0
    assert ratio["estimate"] == pytest.approx(
        estimates["E_glandular"]["estimate"] / estimates["E_fat"]["estimate"]
    )
    assert {one["quotable"] for one in estimates.values()} == {False}
    why = "only its ratio to the other stiffnesses can be found"
    assert all(why in one["reasons"] for one in estimates.values())
    assert set(ratio) >= {"interval", "quotable", "reasons"}
    assert main(["report", str(folder)]) == 0
    shown = capsys.readouterr().out
    assert "arbitrary scale" in shown
    assert "Not quotable: E_fat" in shown
