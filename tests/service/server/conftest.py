"""A service shared by the tests of this folder, with two workers and trivial tasks."""

import os
from collections.abc import Iterator

import pytest

from palpate.service.remote_client import Client
from tests.service.server.service_process import ServiceProcess, running_service


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    home = tmp_path_factory.mktemp("service") / "runs"
    with running_service(home, ["--workers", "2"]) as served:
        yield served


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[Client]:
    with service.client() as connected:
        yield connected


@pytest.fixture(autouse=True)
def _no_token_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    if "PALPATE_TOKEN" in os.environ:
        monkeypatch.delenv("PALPATE_TOKEN")
