"""Fixtures of the tests of service."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cli import main
from palpate.service.cluster import dask_cluster as cluster_module
from palpate.service.study import study_session as session_module


@pytest.fixture
def call(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run a command in an empty folder; return exit code, standard output and standard error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "140")

    def calling(*arguments: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    return calling


@pytest.fixture
def no_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make opening a cluster fail, so that results must come from the store."""

    def refuse(*arguments: Any) -> None:
        raise AssertionError("a cluster was opened")

    monkeypatch.setattr(cluster_module, "open_cluster", refuse)
    monkeypatch.setattr(session_module, "open_cluster", refuse)
