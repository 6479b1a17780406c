"""The compose topology as plain processes: scheduler, two workers, service, object store."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

import palpate
from palpate.service.study.study_folder import read_study
from palpate.storage.store import open_store
from palpate.storage.upkeep import check_store
from tests.recovery.processes import plain_cluster, unused_port

STUDY = """
name: small
case: {reference: {phantom: {preset: 250ml, spacing_mm: 2}}, mesh: {nodes: 1200}}
target: {constants: {E_fat_kpa: 12, E_glandular_kpa: 30}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 4
  generations: 2
seed: 3
"""
TOKEN = "a-token-of-the-tests"


@pytest.mark.slow
def test_study_runs_on_every_topology(bucket: str, tmp_path: Path) -> None:
    store, port = f"{bucket}/store", unused_port()
    url = f"http://127.0.0.1:{port}"
    with plain_cluster(tmp_path, 2) as scheduler:
        command = [sys.executable, "-m", "palpate", "serve", str(tmp_path / "runs")]
        command += ["--scheduler", scheduler, "--store", store, "--port", str(port)]
        environment = os.environ | {"PALPATE_TOKEN": TOKEN}
        with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as service:
            try:
                wait_until_healthy(url, service)
                with palpate.connect(url, TOKEN) as connected:
                    job = connected.submit(yaml.safe_load(STUDY))
                    job.wait()
                    results = job.results
            finally:
                service.terminate()
                service.wait(30)
    assert results["estimates"]
    # All data are in the bucket, and no store is in the folder of the service.
    opened = open_store(store, create=False)
    found = check_store(opened)
    assert found.damages == []
    assert found.leftovers == []
    _, log = read_study(tmp_path / "runs" / "small")
    digests = {record.digest for record in log.endings.values()}
    assert found.counts["evaluations"] > len(digests) >= 4  # and that of the target
    assert not (tmp_path / "runs" / "store").exists()
    assert log.last_session is not None
    assert log.last_session.store == store


def wait_until_healthy(url: str, service: Any, patience_s: float = 90.0) -> None:
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        assert service.poll() is None, "the service has ended"
        try:
            if httpx.get(f"{url}/api/v1/health").status_code == 200:
                return
        except httpx.TransportError:
            time.sleep(0.2)
    raise AssertionError("the service has not become healthy")
