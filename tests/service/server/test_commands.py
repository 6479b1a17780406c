"""`palpate serve` and `palpate token` on the command line."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import palpate
from palpate.service.cli import main
from palpate.service.server.jobs.home_and_tokens import Tokens
from palpate.storage.errors import InputError

PALPATE = [sys.executable, "-m", "palpate"]


@pytest.mark.slow
def test_serve_prints_a_token_once_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    command = [*PALPATE, "serve", "runs", "--scheduler", "tcp://127.0.0.1:9", "--port", "0"]
    said: list[list[str]] = []
    for _ in range(2):
        process = subprocess.Popen(
            command,
            cwd=tmp_path,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        lines: list[str] = []
        while not lines or not lines[-1].startswith("serving "):
            line = process.stdout.readline()
            assert line, process.communicate()
            lines.append(line.strip())
        said.append(lines)
        if len(said) == 2:
            token = said[0][0].rpartition(" ")[2]
            with palpate.connect(lines[-1].rpartition(" ")[2], token) as service:
                until = time.monotonic() + 60
                while "127.0.0.1:9" not in service.cluster().trouble:
                    assert time.monotonic() < until, service.cluster()
                    time.sleep(0.1)
                with pytest.raises(InputError, match="not finished"):
                    service.client.submit_study("name: x")
                with (
                    palpate.connect(service.client.url, "wrong") as stranger,
                    pytest.raises(InputError, match="token is not valid"),
                ):
                    stranger.client.submit_study("name: x")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
        assert "Traceback" not in err
    assert said[0][0].startswith("token (shown once")
    assert len(said[1]) == 1


def test_port_in_use_gives_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        assert main(["serve", "--port", str(other.getsockname()[1])]) == 2
    assert "Choose another --port" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_tokens_are_made_listed_and_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["token", "new", "ann"]) == 0
    token = capsys.readouterr().out.strip()
    path = tmp_path / "runs" / ".service" / "tokens.json"
    known = Tokens(path)
    assert token not in path.read_text()
    assert path.stat().st_mode & 0o077 == 0
    assert (known.owner(token), known.owner(token[:-1]), known.owner("")) == ("ann", None, None)
    assert main(["token", "new", "ann"]) == 2
    assert main(["token", "new", "../x"]) == 2
    assert main(["token", "new", "bob", "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert (made["name"], known.owner(made["token"])) == ("bob", "bob")
    assert known.names == ["ann", "bob"]  # read again without a restart
    assert main(["token", "remove", "ann"]) == 0
    assert known.owner(token) is None
    assert main(["token", "remove", "ann"]) == 2


def test_a_short_token_of_the_environment_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PALPATE_TOKEN", "short")
    with pytest.raises(InputError, match="at least 16"):
        Tokens(tmp_path / "tokens.json")
