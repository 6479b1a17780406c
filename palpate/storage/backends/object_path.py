"""Paths of objects and folders in a bucket."""

import re
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Literal, get_args

from palpate.storage.errors import StoreError

Scheme = Literal["s3", "gs", "az"]
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)

# Allowed by any of the services: Google allows underscores, Azure no dots, all of them the rest.
_BUCKET = re.compile(r"[a-z0-9][a-z0-9._-]{1,61}[a-z0-9]")


@dataclass(frozen=True, slots=True, order=True)
class ObjectPath:
    """An address such as ``s3://bucket/key``.

    Parameters
    ----------
    bucket : str
        Bucket name, or container name on Azure.
    key : str
        Without leading or trailing slashes; empty for the bucket itself.
    scheme : {"s3", "gs", "az"}
        S3, Google Cloud Storage or Azure Blob Storage.

    Examples
    --------
    >>> volume = ObjectPath("lab", "palpate") / "volumes" / "3f2a.zarr"
    >>> str(volume), volume.name, volume.stem
    ('s3://lab/palpate/volumes/3f2a.zarr', '3f2a.zarr', '3f2a')
    """

    bucket: str
    key: str = ""
    scheme: Scheme = "s3"

    def __truediv__(self, name: str) -> "ObjectPath":
        return replace(self, key=f"{self.key}/{name}".strip("/"))

    def __str__(self) -> str:
        return f"{self.scheme}://{self.bucket}/{self.key}".rstrip("/")

    @property
    def name(self) -> str:
        """Return the last part."""
        return self.key.rpartition("/")[2]

    @property
    def stem(self) -> str:
        """Return the last part without its suffix."""
        return PurePosixPath(self.key).stem

    @property
    def suffix(self) -> str:
        """Return the suffix of the last part, with its dot."""
        return PurePosixPath(self.key).suffix

    @property
    def parent(self) -> "ObjectPath":
        """Return the parent folder."""
        return replace(self, key=self.key.rpartition("/")[0])


def object_path(scheme: Scheme, rest: str, location: object) -> ObjectPath:
    """Parse the part of an address after ``s3://``, ``gs://`` or ``az://``.

    Raises
    ------
    StoreError
        If there is no valid bucket name.
    """
    bucket, _, key = rest.strip("/").partition("/")
    if not _BUCKET.fullmatch(bucket):
        raise StoreError(
            f"{location} names no bucket: {bucket!r} is not 3 to 63 lowercase letters, digits, "
            f"dots, dashes and underscores. Give an address such as {scheme}://my-bucket/palpate."
        )
    parts = [part for part in key.split("/") if part]
    if any(part in (".", "..") for part in parts):
        raise StoreError(f"{location} has '.' or '..' in its key. Give the key without them.")
    return ObjectPath(bucket, "/".join(parts), scheme)
