"""One service for the tests of this room, with two workers and tasks that take no time."""

import os
from collections.abc import Iterator

import pytest
from service_process import ServiceProcess

from service.client import Client


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    home = tmp_path_factory.mktemp("service") / "runs"
    served = ServiceProcess(home, ["--workers", "2"]).start()
    yield served
    assert served.process is not None
    assert served.process.poll() is None, "the service went down"
    assert served.stop() == 0
    assert "Traceback" not in served.log, served.log


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[Client]:
    with service.client() as connected:
        yield connected


@pytest.fixture(autouse=True)
def _no_token_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    if "PALPATE_TOKEN" in os.environ:
        monkeypatch.delenv("PALPATE_TOKEN")
