"""Certificates for mutual authentication of scheduler, workers and clients.

::

    ca.pem                      signs the others; needed on every machine
    ca.key                      kept by whoever runs the cluster
    scheduler.pem, .key         for the scheduler
    worker.pem, .key            for all workers and their nannies
    client.pem, .key            for those who may submit
    dask.yaml                   equivalent to the variables of `environment`

Dask accepts any certificate signed by the CA and does not check host names, so certificates
work on any machine: whoever has a key and can reach the port can run code.
"""

import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from palpate.storage.backends.atomic_files import explained, publishing
from palpate.storage.errors import InputError

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from distributed import Security

ROLES = ("scheduler", "worker", "client")
CLOCK_DIFFERENCE = timedelta(hours=1)


@dataclass(frozen=True)
class Certificates:
    """A folder of certificates.

    Parameters
    ----------
    folder : Path
        An absolute path.
    """

    folder: Path

    def environment(self) -> dict[str, str]:
        """Return the environment variables that make Dask use them, in any role."""
        found = {
            "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "True",
            "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(self.folder / "ca.pem"),
        }
        for role in ROLES:
            start = f"DASK_DISTRIBUTED__COMM__TLS__{role.upper()}"
            found[f"{start}__CERT"] = str(self.folder / f"{role}.pem")
            found[f"{start}__KEY"] = str(self.folder / f"{role}.key")
        return found

    def as_yaml(self) -> str:
        """Return the equivalent Dask configuration file."""
        tls: dict[str, object] = {"ca-file": str(self.folder / "ca.pem")}
        for role in ROLES:
            tls[role] = {
                "cert": str(self.folder / f"{role}.pem"),
                "key": str(self.folder / f"{role}.key"),
            }
        comm = {"require-encryption": True, "tls": tls}
        return yaml.safe_dump({"distributed": {"comm": comm}}, sort_keys=False)


def make_certificates(folder: Path, days: int = 365) -> Certificates:
    """Create a CA and one certificate for each role; keys are readable by their owner only.

    Parameters
    ----------
    folder : Path
        Created; must be missing or empty.
    days : int
        Validity of the certificates.

    Raises
    ------
    InputError
        If the folder is not empty.
    StoreError
        If the folder cannot be written.
    """
    folder = folder.expanduser().absolute()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"{folder} exists and is not empty: certificates are never replaced. Give another "
            "folder, or remove this one; every process of the cluster then needs the new ones."
        )
    from cryptography.hazmat.primitives.asymmetric import ec

    made = Certificates(folder)
    ca_key = ec.generate_private_key(ec.SECP256R1())
    ca = _signed("Palpate cluster CA", ca_key, None, ca_key, days)
    with explained(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with publishing(folder) as temporary:
            temporary.mkdir(mode=0o700)
            _write(temporary, "ca", ca, ca_key)
            for role in ROLES:
                key = ec.generate_private_key(ec.SECP256R1())
                _write(temporary, role, _signed(f"Palpate {role}", key, ca, ca_key, days), key)
            (temporary / "dask.yaml").write_text(made.as_yaml())
    return made


def temporary_security() -> "Security":
    """Return certificates in memory, for a cluster that lives as long as this process.

    Like ``distributed.Security.temporary``, but with an elliptic curve, which takes milliseconds.
    """
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from distributed import Security

    key = ec.generate_private_key(ec.SECP256R1())
    pem = serialization.Encoding.PEM
    certificate = _signed("Palpate cluster", key, None, key, 365).public_bytes(pem).decode()
    private = _private(key).decode()
    roles = {f"tls_{role}_cert": certificate for role in ROLES}
    roles |= {f"tls_{role}_key": private for role in ROLES}
    return Security(require_encryption=True, tls_ca_file=certificate, **roles)


def _private(key: "EllipticCurvePrivateKey") -> bytes:
    from cryptography.hazmat.primitives import serialization

    unlocked = serialization.NoEncryption()
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, unlocked
    )


def _signed(
    name: str,
    key: "EllipticCurvePrivateKey",
    issuer: "x509.Certificate | None",
    issuer_key: "EllipticCurvePrivateKey",
    days: int,
) -> "x509.Certificate":
    """Return a certificate (RFC 5280), self-signed for a CA if there is no issuer."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    is_ca = issuer is None
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    usage = x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=is_ca,
        crl_sign=is_ca,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    built = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer.subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_DIFFERENCE)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=is_ca, path_length=0 if is_ca else None), True)
        .add_extension(usage, True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()), False
        )
    )
    if not is_ca:
        both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        built = built.add_extension(x509.ExtendedKeyUsage(both), False)
    return built.sign(issuer_key, hashes.SHA256())


def _write(
    folder: Path, name: str, certificate: "x509.Certificate", key: "EllipticCurvePrivateKey"
) -> None:
    from cryptography.hazmat.primitives import serialization

    pem = serialization.Encoding.PEM
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(pem))
    handle = os.open(folder / f"{name}.key", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(_private(key))
