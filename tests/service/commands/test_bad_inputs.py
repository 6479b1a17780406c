"""Bad inputs give one message and exit code 2, and no partial files.

Interrupts, streams and terminals are those of the command as a user types it; what needs no
shell runs in forks of one process.
"""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import typer

from palpate.service import cli
from tests.service.commands.bad_inputs import BAD_INPUTS, STUDY, BadInput
from tests.service.forked_commands import ForkedCommands, forked_commands

ROOT = Path(__file__).parents[3]
BIN = Path(sys.executable).parent
# Capabilities that let root write everywhere.
PLAIN_USER = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search", "--inh-caps"]
PLAIN_USER += ["-dac_override,-dac_read_search"]

Ran = subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def palpate(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return an environment where `palpate` runs this source."""
    found = BIN / "palpate"
    if not found.exists():
        found = tmp_path_factory.mktemp("bin") / "palpate"
        found.write_text(f'#!/bin/sh\nexec {sys.executable} -m palpate "$@"\n')
        found.chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PALPATE_")}
    path = f"{found.parent}{os.pathsep}{os.environ['PATH']}"
    return environment | {"PATH": path, "PYTHONPATH": str(ROOT), "COLUMNS": "100"}


@pytest.fixture(scope="module")
def forked(palpate: dict[str, str]) -> Iterator[ForkedCommands]:
    """Run commands without the time for imports."""
    with forked_commands(palpate) as commands:
        yield commands


@pytest.fixture(scope="module")
def forked_as_plain_user(palpate: dict[str, str]) -> Iterator[ForkedCommands]:
    """Run commands without root's permission to write everywhere."""
    if os.geteuid() == 0 and shutil.which("setpriv") is None:
        pytest.skip("setpriv, which makes root a user like others, is not installed")
    with forked_commands(palpate, PLAIN_USER if os.geteuid() == 0 else ()) as commands:
        yield commands


@pytest.fixture
def run(
    request: pytest.FixtureRequest, palpate: dict[str, str], tmp_path: Path
) -> Callable[[BadInput, Path], Ran]:
    """Run the command of a case."""

    def in_shell(case: BadInput, place: Path) -> Ran:
        return subprocess.run(
            ["bash", "-c", case.command],
            cwd=place / case.folder,
            env=palpate | dict(case.environment),
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )

    def in_fork(case: BadInput, place: Path) -> Ran:
        user = "forked_as_plain_user" if case.plain_user else "forked"
        name, *arguments = shlex.split(case.command)
        assert name == "palpate"
        commands = request.getfixturevalue(user)
        return commands(arguments, place / case.folder, tmp_path, case.environment)

    return lambda case, place: (in_shell if case.in_shell else in_fork)(case, place)


def files(place: Path) -> set[str]:
    """Return the contents of a folder, without the parts of a store."""
    everything = {str(path.relative_to(place)) for path in place.rglob("*") if not path.is_dir()}
    return {name for name in everything if not name.startswith(("runs/store/", "s/"))}


@pytest.mark.parametrize("name", BAD_INPUTS)
def test_error_message_exit_code_and_no_partial_files(
    run: Callable[[BadInput, Path], Ran], tmp_path: Path, name: str
) -> None:
    case, place = BAD_INPUTS[name], tmp_path / "place"
    place.mkdir()
    (place / "study.yaml").write_text(STUDY)
    case.prepare(place)
    before = files(place)
    done = run(case, place)
    written = files(place) - before
    said = done.stderr
    assert "Traceback" not in said + done.stdout, said
    assert done.returncode == case.code, said
    assert case.said in " ".join(said.split()), said
    assert said.count("Error: ") == (1 if case.code == 2 else 0), said
    assert len(said) < 3000, said
    assert written == set()
    assert not [path for path in place.rglob("*") if path.name.startswith(".tmp-")]


# --- interrupts --------------------------------------------------------------------


def test_unhandled_interrupt_is_reported(
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
# None: after it has started.
@pytest.mark.parametrize("after_s", [0.0, 0.3, pytest.param(None, marks=pytest.mark.slow)])
def test_interrupt_prints_how_to_continue(
    palpate: dict[str, str], tmp_path: Path, number: int, after_s: float | None
) -> None:
    (tmp_path / "my study.yaml").write_text(STUDY)
    arguments = ["run", "my study.yaml", "--store", "a store", "--workers", "1"]
    # A shell without job control starts background processes ignoring SIGINT; a signal with a
    # handler here is reset to its default in the child.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(
        ["palpate", *arguments],
        cwd=tmp_path,
        env=palpate,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        if after_s is None:
            assert process.stdout is not None
            assert process.stdout.readline()
        else:
            time.sleep(after_s)
        process.send_signal(number)
        _, said = process.communicate(timeout=300)
    assert "Traceback" not in said
    if process.returncode == -number:  # before Python handled the signal
        assert after_s is not None
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
def test_output_is_complete_on_unusual_terminals(
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
