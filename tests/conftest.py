"""Fixtures for several folders: an object server and a bucket."""

from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="session")
def object_server() -> Iterator[Any]:
    """A running S3 server; skips where one is missing."""
    from tests.storage.object_server import started

    server = started()
    yield server
    server.stop()


@pytest.fixture
def bucket(object_server: Any, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of an empty bucket, which this process and its children can reach."""
    from tests.storage.object_server import set_environment

    set_environment(object_server.environment, monkeypatch)
    return f"s3://{object_server.new_bucket()}"


@pytest.fixture
def stoppable_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A server of the test's own, which it may stop and start."""
    from tests.storage.object_server import set_environment, started

    server = started()
    set_environment(server.environment, monkeypatch)
    yield server
    server.stop()
