"""Names one object, or a folder of objects, in a bucket: the part of a path that a store needs."""

import re
from dataclasses import dataclass
from pathlib import PurePosixPath

from palpate.storage.errors import StoreError

# S3's own rule; other servers are laxer about dots, none about the rest.
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
        """Return what stands behind the last dot of the last part, and the dot."""
        return PurePosixPath(self.key).suffix

    @property
    def parent(self) -> "ObjectPath":
        """Return the folder in which it lies."""
        return ObjectPath(self.bucket, self.key.rpartition("/")[0])


def object_path(rest: str, location: object) -> ObjectPath:
    """Read what stands behind ``s3://``.

    Raises
    ------
    StoreError
        If it names no bucket.
    """
    bucket, _, key = rest.strip("/").partition("/")
    if not _BUCKET.fullmatch(bucket):
        raise StoreError(
            f"{location} names no bucket: {bucket!r} is not 3 to 63 small letters, digits, dots "
            "and dashes. Give an address such as s3://my-bucket/palpate."
        )
    parts = [part for part in key.split("/") if part]
    if any(part in (".", "..") for part in parts):
        raise StoreError(f"{location} has '.' or '..' in its key. Give the key without them.")
    return ObjectPath(bucket, "/".join(parts))
