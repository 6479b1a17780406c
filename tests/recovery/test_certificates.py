"""A cluster on TLS: who has the certificates works with it, and nobody else."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from processes import unused_port

from service.cluster import open_cluster
from service.errors import ClusterError

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install .[tls]")

WORK = """
import json, sys
from service.cluster import open_cluster
with open_cluster(sys.argv[1]) as cluster:
    cluster.client.wait_for_workers(1, timeout=60)
    print(json.dumps(cluster.client.submit(abs, -7).result(timeout=60)))
"""


def palpate(*words: str, **options: object) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "service", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@contextmanager
def cluster_on_tls(certificates: Path) -> Iterator[str]:
    """The commands that `palpate certs` prints, with a worker."""
    port, environment = unused_port(), os.environ | {"DASK_CONFIG": str(certificates)}
    address = f"tls://127.0.0.1:{port}"
    listen = ["scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", str(port)]
    worker = ["worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    with (certificates.parent / "log").open("w") as log:
        started = [
            subprocess.Popen(
                [sys.executable, "-m", "dask", *words], env=environment, stdout=log, stderr=log
            )
            for words in ([*listen, "--no-dashboard"], worker)
        ]
    try:
        yield address
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def test_only_who_has_the_certificates_gets_in(tmp_path: Path) -> None:
    folder = tmp_path / "certificates"
    made = palpate("certs", str(folder), "--host", "node1.lab", "--host", "10.0.0.5")
    assert made.returncode == 0, made.stderr
    assert f"export DASK_CONFIG={folder}" in made.stdout
    for key in folder.glob("*-key.pem"):
        assert key.stat().st_mode & 0o077 == 0
    with cluster_on_tls(folder) as address:
        inside = subprocess.run(
            [sys.executable, "-c", WORK, address],
            env=os.environ | {"DASK_CONFIG": str(folder)},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert inside.returncode == 0, inside.stderr
        assert json.loads(inside.stdout) == 7
        plain = address.replace("tls://", "tcp://")
        for stranger, why in ((address, "asks for certificates"), (plain, "There is no scheduler")):
            with pytest.raises(ClusterError, match=why), open_cluster(stranger):
                pass


def test_certificates_are_never_overwritten(tmp_path: Path) -> None:
    folder = str(tmp_path / "certificates")
    assert palpate("certs", folder).returncode == 0
    before = (tmp_path / "certificates" / "authority.pem").read_bytes()
    again = palpate("certs", folder)
    assert again.returncode == 2
    assert "holds certificates already" in again.stderr
    assert (tmp_path / "certificates" / "authority.pem").read_bytes() == before


def test_a_host_that_is_none_is_refused(tmp_path: Path) -> None:
    refused = palpate("certs", str(tmp_path / "c"), "--host", "nöde")
    assert refused.returncode == 2
    assert "is no name of a machine" in refused.stderr
    assert not (tmp_path / "c").exists()
