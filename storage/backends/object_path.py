"""Paths of objects and folders in a bucket."""

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

from palpate.storage.errors import StoreError

# S3's own rule; other servers are laxer, but only about dots.
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


@dataclass(frozen=True, slots=True, order=True)
class ObjectPath:
    """An address such as ``s3://bucket/key``.

    Parameters
    ----------
    bucket : str
    key : str
        Without slashes at its ends; empty for the bucket itself.

    Examples
    --------
    >>> volume = ObjectPath("lab", "palpate") / "volumes" / "3f2a.zarr"
    >>> str(volume), volume.name, volume.stem
    ('s3://lab/palpate/volumes/3f2a.zarr', '3f2a.zarr', '3f2a')
    """

    bucket: str
    key: str = ""

    def __truediv__(self, name: str) -> "ObjectPath":
        return ObjectPath(self.bucket, f"{self.key}/{name}".strip("/"))

    def __str__(self) -> str:
        return f"s3://{self.bucket}/{self.key}".rstrip("/")

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
        return ObjectPath(self.bucket, self.key.rpartition("/")[0])


def object_path(rest: str, location: object) -> ObjectPath:
    """Parse the part of an address after ``s3://``.

    Raises
    ------
    StoreError
        If there is no valid bucket name.
    """
    bucket, _, key = rest.strip("/").partition("/")
    if not _BUCKET.fullmatch(bucket):
        raise StoreError(
            f"{location} names no bucket: {bucket!r} is not 3 to 63 lowercase letters, digits, "
            "dots and dashes. Give an address such as s3://my-bucket/palpate."
        )
    parts = [part for part in key.split("/") if part]
    if any(part in (".", "..") for part in parts):
        raise StoreError(f"{location} has '.' or '..' in its key. Give the key without them.")
    return ObjectPath(bucket, "/".join(parts))
