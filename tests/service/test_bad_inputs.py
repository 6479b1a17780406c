"""Bad inputs end with one message and exit code 2; nothing is half-written.

All commands run as a user types them, two at a time: a minute in all.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest
import typer
from bad_inputs import BAD_INPUTS, STUDY, BadInput

from service import cli

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
AT_ONCE = 2
# Root may write everywhere; without these rights it is a user like others.
PLAIN_USER = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search", "--inh-caps"]
PLAIN_USER += ["-dac_override,-dac_read_search"]

pytestmark = pytest.mark.timeout(1800)
Ran = tuple[subprocess.CompletedProcess[str], Path, set[str]]


@pytest.fixture(scope="module")
def palpate(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return an environment in which `palpate` is the installed command, of this source."""
    found = BIN / "palpate"
    if not found.exists():
        found = tmp_path_factory.mktemp("bin") / "palpate"
        found.write_text(f'#!/bin/sh\nexec {sys.executable} -m palpate "$@"\n')
        found.chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PALPATE_")}
    path = f"{found.parent}{os.pathsep}{os.environ['PATH']}"
    return environment | {"PATH": path, "PYTHONPATH": str(ROOT), "COLUMNS": "100"}


@pytest.fixture(scope="module")
def running(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    palpate: dict[str, str],
) -> Iterator[dict[str, Future[Ran]]]:
    """Start all bad inputs that were asked for."""
    wanted = {
        item.callspec.params["name"]  # type: ignore[attr-defined]
        for item in request.session.items
        if item.path == request.path
        and "name" in getattr(getattr(item, "callspec", None), "params", {})
    }
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {
            name: pool.submit(run, case, tmp_path_factory.mktemp("case"), palpate)
            for name, case in BAD_INPUTS.items()
            if name in wanted
        }


def run(case: BadInput, place: Path, environment: dict[str, str]) -> Ran:
    (place / "study.yaml").write_text(STUDY)
    case.prepare(place)
    before = files(place)
    command = ["bash", "-c", case.command]
    if case.plain_user and os.geteuid() == 0:
        command = [*PLAIN_USER, *command]
    done = subprocess.run(
        command,
        cwd=place,
        env=environment | dict(case.environment),
        capture_output=True,
        text=True,
        errors="replace",
        timeout=600,
        check=False,
    )
    return done, place, files(place) - before


def files(place: Path) -> set[str]:
    """Return what lies in a folder, without what a store is made of."""
    everything = {str(path.relative_to(place)) for path in place.rglob("*") if not path.is_dir()}
    return {name for name in everything if not name.startswith(("runs/store/", "s/"))}


@pytest.mark.parametrize("name", BAD_INPUTS)
def test_one_message_exit_code_2_and_nothing_half_written(
    running: dict[str, Future[Ran]], name: str
) -> None:
    case = BAD_INPUTS[name]
    if case.plain_user and os.geteuid() == 0 and shutil.which("setpriv") is None:
        pytest.skip("setpriv, which makes root a user like others, is not installed")
    done, place, written = running[name].result()
    said = done.stderr
    assert "Traceback" not in said + done.stdout, said
    assert done.returncode == case.code, said
    assert case.said in " ".join(said.split()), said
    assert said.count("Error: ") == (1 if case.code == 2 else 0), said
    assert len(said) < 3000, said
    assert written == set()
    assert not [path for path in place.rglob("*") if path.name.startswith(".tmp-")]


# --- interrupts --------------------------------------------------------------------


def test_an_interrupt_that_no_command_has_noticed_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped = typer.Typer()

    @stopped.command()
    def stop() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "app", stopped)
    assert cli.main([]) == 130
    assert capsys.readouterr().err == "Interrupted.\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.5])
def test_an_interrupt_says_how_to_go_on(
    palpate: dict[str, str], tmp_path: Path, number: int, after_s: float
) -> None:
    (tmp_path / "my study.yaml").write_text(STUDY)
    arguments = ["run", "my study.yaml", "--store", "a store", "--workers", "1"]
    # A shell without job control starts what is in the background deaf to SIGINT, and its
    # children too; what has a handler here begins with the default there.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(
        ["palpate", *arguments],
        cwd=tmp_path,
        env=palpate,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as process:
        time.sleep(after_s)
        process.send_signal(number)
        _, said = process.communicate(timeout=300)
    assert "Traceback" not in said
    if process.returncode == -number:  # before Python could take notice
        assert after_s < 1
        return
    assert process.returncode == 130
    again = "palpate run 'my study.yaml' --store 'a store' --workers 1"
    assert again in said or said.strip() == "Interrupted."


# --- terminals ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "environment",
    [
        {"COLUMNS": "1"},
        {"COLUMNS": "many"},
        {"TERM": "dumb"},
        {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
        {"NO_COLOR": "1", "HOME": "/nonexistent"},
    ],
    ids=lambda environment: next(iter(environment)),
)
def test_strange_terminals_get_their_text(
    palpate: dict[str, str], tmp_path: Path, environment: dict[str, str]
) -> None:
    done = subprocess.run(
        ["palpate", "parameters"],
        cwd=tmp_path,
        env=palpate | environment,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == b""
    assert b"E_fat_kpa" in done.stdout
