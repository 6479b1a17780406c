"""Makes certificates that put Dask's own ports on TLS, and the configuration that uses them.

::

    <folder>/
      authority.pem, authority-key.pem   signs the others; the key is needed for more only
      cluster.pem, cluster-key.pem       of scheduler, workers and clients
      dask.yaml                          read by Dask where DASK_CONFIG names the folder

Dask lets everybody in whose certificate the authority has signed, and nobody else: whoever
reads `cluster-key.pem` may run code on the workers.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from storage.atomic import explained
from storage.errors import InputError

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

EARLIER = timedelta(hours=1)  # clocks of a cluster may differ


def make_certificates(folder: Path, hosts: Sequence[str], days: int) -> None:
    """Make an authority, a certificate of the cluster, and Dask's configuration.

    Parameters
    ----------
    folder : Path
        Must not hold certificates yet.
    hosts : sequence of str
        Names and addresses of the machines, beside this one.
    days : int
        How long they are valid.

    Raises
    ------
    InputError
        If there are certificates already, or the package cryptography is missing.
    StoreError
        If they cannot be written.
    """
    try:
        from cryptography import x509
    except ImportError as error:
        raise InputError("Certificates need a package: pip install 'palpate[tls]'.") from error
    folder = folder.expanduser().absolute()
    if (folder / "authority.pem").exists():
        raise InputError(f"{folder} holds certificates already: remove them or choose another.")
    authority_key, cluster_key = _key(), _key()
    authority = _signed(
        "Palpate authority", authority_key, None, authority_key, days
    ).add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    names = [_name(host) for host in ("localhost", "127.0.0.1", "::1", *hosts)]
    cluster = (
        _signed("Palpate cluster", cluster_key, "Palpate authority", authority_key, days)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    )
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
        _write(folder, "authority", authority, authority_key, authority_key)
        _write(folder, "cluster", cluster, authority_key, cluster_key)
        (folder / "dask.yaml").write_text(yaml.safe_dump(_configuration(folder)))


def _configuration(folder: Path) -> dict[str, Any]:
    own = {"cert": str(folder / "cluster.pem"), "key": str(folder / "cluster-key.pem")}
    roles = dict.fromkeys(("scheduler", "worker", "client"), own)
    tls = {"ca-file": str(folder / "authority.pem")} | {r: dict(o) for r, o in roles.items()}
    return {"distributed": {"comm": {"require-encryption": True, "tls": tls}}}


def _key() -> "EllipticCurvePrivateKey":
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _signed(
    name: str,
    key: "EllipticCurvePrivateKey",
    issuer: str | None,
    issuer_key: "EllipticCurvePrivateKey",
    days: int,
) -> "x509.CertificateBuilder":
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    def called(text: str) -> x509.Name:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])

    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(called(name))
        .issuer_name(called(issuer or name))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - EARLIER)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()),
            critical=False,
        )
    )


def _name(host: str) -> "x509.GeneralName":
    from cryptography import x509

    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise InputError(
            f"{host!r} is no name of a machine: expected such as node1.lab."
        ) from error


def _write(
    folder: Path,
    name: str,
    builder: "x509.CertificateBuilder",
    signing_key: "EllipticCurvePrivateKey",
    key: "EllipticCurvePrivateKey",
) -> None:
    from cryptography.hazmat.primitives import hashes, serialization

    pem = serialization.Encoding.PEM
    private = folder / f"{name}-key.pem"
    private.touch(mode=0o600)
    private.write_bytes(
        key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    certificate = builder.sign(signing_key, hashes.SHA256())
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(pem))
