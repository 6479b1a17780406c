"""`palpate certs`: scheduler, worker and client processes authenticate each other by TLS."""

import json
import os
import socket
import ssl
import stat
import subprocess
import sys
import threading
from pathlib import Path

import dask
import pytest

from palpate.service.cli import main
from palpate.service.cluster.certificates import ROLES, Certificates, make_certificates
from palpate.service.cluster.dask_cluster import open_cluster
from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.errors import InputError
from tests.recovery.processes import HERE, plain_cluster
from tests.recovery.stand_ins import Inline, run, told

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install '.[tls]'")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return make_certificates(tmp_path_factory.mktemp("certs") / "tls")


def context(certificates: Certificates, role: str, purpose: ssl.Purpose) -> ssl.SSLContext:
    """Return Python's strictest context, except for the host name, which Dask does not check."""
    made = ssl.create_default_context(purpose, cafile=certificates.folder / "ca.pem")
    made.load_cert_chain(certificates.folder / f"{role}.pem", certificates.folder / f"{role}.key")
    made.check_hostname, made.verify_mode = False, ssl.CERT_REQUIRED
    made.verify_flags |= ssl.VERIFY_X509_STRICT
    return made


@pytest.mark.parametrize("role", ROLES)
def test_every_role_and_the_scheduler_authenticate_each_other(
    certificates: Certificates, role: str
) -> None:
    ours, theirs = socket.socketpair()
    names: list[object] = []

    def serve() -> None:
        scheduler = context(certificates, "scheduler", ssl.Purpose.CLIENT_AUTH)
        with scheduler.wrap_socket(theirs, server_side=True) as accepted:
            names.append(accepted.getpeercert())

    thread = threading.Thread(target=serve)
    thread.start()
    client = context(certificates, role, ssl.Purpose.SERVER_AUTH)
    with client.wrap_socket(ours) as connected:
        assert connected.version() == "TLSv1.3"
        assert "Palpate scheduler" in str(connected.getpeercert())
    thread.join()
    assert f"Palpate {role}" in str(names[0])


def test_keys_are_private_and_certificates_never_replaced(certificates: Certificates) -> None:
    folder = certificates.folder
    keys = sorted(folder.glob("*.key"))
    assert [key.stem for key in keys] == ["ca", "client", "scheduler", "worker"]
    assert {stat.S_IMODE(key.stat().st_mode) for key in keys} == {0o600}
    before = (folder / "ca.pem").read_bytes()
    with pytest.raises(InputError, match="never replaced"):
        make_certificates(folder)
    assert (folder / "ca.pem").read_bytes() == before


def test_command_prints_shell_exports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["certs", str(tmp_path / "my tls"), "--days", "7"]) == 0
    lines = capsys.readouterr().out
    shown = subprocess.run(
        ["sh", "-c", f"{lines}\nenv"], capture_output=True, text=True, check=True
    ).stdout
    for name, value in Certificates(tmp_path / "my tls").environment().items():
        assert f"{name}={value}" in shown.splitlines()
    assert main(["certs", str(tmp_path / "json"), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["environment"] == Certificates(tmp_path / "json").environment()
    assert main(["certs", str(tmp_path / "json")]) == 2
    assert "never replaced" in capsys.readouterr().err


def driver(folder: Path, address: str, environment: dict[str, str]) -> tuple[int, str]:
    """Run a study with a driver in a separate process."""
    command = [sys.executable, str(HERE / "driver.py"), str(folder), "--scheduler", address]
    done = subprocess.run(
        command,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stderr


def is_served(port: int, tls: ssl.SSLContext) -> bool:
    """Return True if the scheduler sends its greeting to a client with these certificates."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as plain:
        try:
            with tls.wrap_socket(plain) as encrypted:
                return bool(encrypted.recv(1))
        except (ssl.SSLError, ConnectionError):
            return False


def test_study_runs_over_tls_and_rejects_unknown_clients(
    certificates: Certificates, tmp_path: Path
) -> None:
    run(tmp_path / "calm" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    with plain_cluster(tmp_path, 1, tls=certificates.environment()) as address:
        assert address.startswith("tls://")
        assert driver(folder, address, certificates.environment()) == (0, "")
        port = int(address.rpartition(":")[2])
        assert is_served(port, context(certificates, "client", ssl.Purpose.SERVER_AUTH))
        nobody = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        nobody.check_hostname, nobody.verify_mode = False, ssl.CERT_NONE
        assert not is_served(port, nobody)
        other = make_certificates(tmp_path / "other")
        stranger = context(other, "client", ssl.Purpose.SERVER_AUTH)
        stranger.verify_mode = ssl.CERT_NONE  # the scheduler has to refuse
        assert not is_served(port, stranger)
        with pytest.raises(ClusterError, match="needs certificates"), open_cluster(address):
            pass
        plain = address.replace("tls", "tcp")
        with (
            dask.config.set({"distributed.comm.require-encryption": True}),
            pytest.raises(ClusterError, match="is not encrypted"),
            open_cluster(plain),
        ):
            pass
    assert told(folder) == told(tmp_path / "calm" / "demo")
