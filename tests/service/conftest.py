"""Fixtures of the room."""

from typing import Any

import pytest

from service import cluster as cluster_module


@pytest.fixture
def no_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens a cluster fails: what is asked for must be in the store."""

    def refuse(*arguments: Any) -> None:
        raise AssertionError("a cluster was opened")

    monkeypatch.setattr(cluster_module, "open_cluster", refuse)
