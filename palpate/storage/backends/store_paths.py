"""Places of stores, all paths in a study and in a store, and what a backend does with them.

::

    <study>/                    one study, made by `palpate run`
      study.yaml                the study file
      journal.jsonl             the journal
      findings.json             findings about the fitted body other than its constants
      report.html               the report
      palpate.log               the log, with times and errors

    <store>/                    shared by any number of studies
      palpate-store.json        marks a store, and gives its schema version
      volumes/<digest>.zarr     phantoms, images, targets and deformed bodies
      meshes/<digest>.zarr      mesh hierarchies
      fields/<digest>.zarr      nodal displacements
      evaluations/<digest>.json finished evaluations
      overruns/<digest>-<n>     evaluations that exceeded their deadline for the n-th time
      locks/<name>.json         the process that is maintaining the store

A study is a local folder; a store is a local folder or part of a bucket. A `Location` is typed by
a user and sent to the workers; a `Place` addresses the parts of a store. Both kinds of place have
``/``, ``name``, ``stem``, ``suffix`` and ``parent``.

Two modules implement the operations of a `Backend`::

    palpate.storage.backends.folder_backend   a folder: temporary names, renamed when complete
    palpate.storage.backends.bucket_backend   a prefix in a bucket: conditional puts, descriptions
                                              last

An object with a name is complete, and if two writers use the same name, one of them wins: both
modules guarantee this, and `tests/storage/test_backends.py` tests both.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Generic, Literal, Protocol, TypeAlias, TypeVar, get_args

from palpate.storage.errors import StoreError

if TYPE_CHECKING:
    import zarr

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


Place = Path | ObjectPath
Location = str | Path | ObjectPath

# Making a Path of a URL drops one of its slashes.
_LOCATION_URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+):/+(?P<rest>.*)")


def place_of(location: Location) -> Place:
    """Return the place of a location; a local one is absolute.

    Parameters
    ----------
    location : str, Path or ObjectPath
        A folder (``~`` is the user's home), or ``s3://``, ``gs://`` or ``az://BUCKET/PREFIX``.

    Raises
    ------
    StoreError
        If it is a URL of another kind, or names no bucket.
    """
    if isinstance(location, ObjectPath):
        return location
    url = _LOCATION_URL.fullmatch(str(location))
    if url is None:
        return Path(location).expanduser().absolute()
    for scheme in SCHEMES:
        if url["scheme"].lower() == scheme:
            return object_path(scheme, url["rest"], location)
    raise StoreError(
        f"{location} is a URL ({url['scheme']}), but stores are kept in local folders and in "
        "object stores only. Give a folder that all workers can reach, such as /data/palpate, or "
        "s3://, gs:// or az://BUCKET/PREFIX."
    )


_ENTRY_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


@dataclass(frozen=True, slots=True)
class StudyLayout:
    """Paths of one study.

    Parameters
    ----------
    root : Path
        Folder of the study.
    """

    root: Path

    @property
    def study(self) -> Path:
        """Return the path of the study file, as it was when the study began."""
        return self.root / "study.yaml"

    @property
    def journal(self) -> Path:
        """Return the path of the journal; see `storage.journal`."""
        return self.root / "journal.jsonl"

    @property
    def findings(self) -> Path:
        """Return the path of the findings about the fitted body; see `organ_plugins`."""
        return self.root / "findings.json"

    @property
    def log(self) -> Path:
        """Return the path of the log."""
        return self.root / "palpate.log"

    @property
    def report(self) -> Path:
        """Return the path of the report."""
        return self.root / "report.html"


@dataclass(frozen=True, slots=True)
class StoreLayout:
    """Paths of one store.

    Parameters
    ----------
    root : Path or ObjectPath
        Folder of the store, or its prefix in a bucket.
    """

    root: Place

    @property
    def marker(self) -> Place:
        """Return the path of the file that marks a folder as a store."""
        return self.root / "palpate-store.json"

    @property
    def volumes(self) -> Place:
        """Return the folder of bodies: voxel volumes, or sections as named arrays."""
        return self.root / "volumes"

    @property
    def meshes(self) -> Place:
        """Return the folder of mesh hierarchies."""
        return self.root / "meshes"

    @property
    def fields(self) -> Place:
        """Return the folder of displacements."""
        return self.root / "fields"

    @property
    def evaluations(self) -> Place:
        """Return the folder of finished evaluations."""
        return self.root / "evaluations"

    @property
    def locks(self) -> Place:
        """Return the folder of locks."""
        return self.root / "locks"

    @property
    def folders(self) -> tuple[Place, ...]:
        """Return all folders with the contents of a store."""
        return self.volumes, self.meshes, self.fields, self.evaluations

    def volume(self, digest: str) -> Place:
        """Return the path of one voxel volume."""
        return self.volumes / f"{_checked_name(digest)}.zarr"

    def mesh(self, digest: str) -> Place:
        """Return the path of one mesh hierarchy."""
        return self.meshes / f"{_checked_name(digest)}.zarr"

    def field(self, digest: str) -> Place:
        """Return the path of one displacement field."""
        return self.fields / f"{_checked_name(digest)}.zarr"

    def lock(self, name: str) -> Place:
        """Return the path of one lock; see `storage.upkeep`."""
        return self.locks / f"{_checked_name(name)}.json"

    def evaluation(self, digest: str) -> Place:
        """Return the path of one finished evaluation."""
        return self.evaluations / f"{_checked_name(digest)}.json"

    def overrun(self, digest: str, number: int) -> Place:
        """Return the path of the file that marks the n-th overrun of an evaluation."""
        return self.root / "overruns" / f"{_checked_name(digest)}-{number}"


def _checked_name(digest: str) -> str:
    if not _ENTRY_NAME.fullmatch(digest):
        raise StoreError(
            f"{digest!r} is not a valid name: expected a digest of letters and digits, "
            "such as 3f2a9c0d1b7e6a54."
        )
    return digest


P = TypeVar("P")
DESCRIPTION = "zarr.json"
ARRAYS_IN = "arrays_in"

FillGroup: TypeAlias = "Callable[[zarr.Group], None]"


@dataclass(frozen=True, slots=True)
class Entry(Generic[P]):
    """One entry in a folder of a store.

    Parameters
    ----------
    place : Path or ObjectPath
        A file, or a group of arrays.
    modified_s : float
        Time of the last write, in seconds since 1970.
    half_written : bool
        True if its writer has not finished, or never will; readers skip it.
    """

    place: P
    modified_s: float
    half_written: bool


@dataclass(frozen=True, slots=True)
class ZarrAddress:
    """Address of a group for Zarr.

    Parameters
    ----------
    store : path or zarr store
    path : str
        Inside the store; empty for its root.
    """

    store: Any
    path: str

    def inside(self, *names: str) -> str:
        """Return the path of a member of the group."""
        return "/".join(part for part in (self.path, *names) if part)


class Backend(Protocol[P]):
    """Reading and writing in one kind of place.

    All methods raise `StoreError` with advice if the place cannot be read or written.
    """

    def read(self, place: P) -> bytes:
        """Return the content of a file.

        Raises
        ------
        FileNotFoundError
            If it does not exist.
        """

    def write(self, place: P, data: bytes) -> None:
        """Write a whole file or nothing, replacing an older one."""

    def create(self, place: P, data: bytes) -> bool:
        """Write a new file; return False and change nothing if it exists.

        If any number of processes do this at once with different data, exactly one gets True.
        """

    def is_file(self, place: P) -> bool:
        """Return True if the file exists."""

    def entries(self, folder: P) -> list[Entry[P]]:
        """Return the entries of a folder, sorted by name; empty if there is no such folder."""

    def size_bytes(self, place: P) -> int:
        """Return the size of a file, or of a whole group."""

    def remove(self, place: P) -> bool:
        """Remove a file or a group so that readers never see half of it; False if missing."""

    def move(self, place: P, target: P) -> None:
        """Rename a file or a group to an unused name, creating folders as needed."""

    def publish_group(self, place: P, attributes: Mapping[str, Any], fill: FillGroup) -> None:
        """Write a Zarr group, whole or not at all; the first writer to finish wins.

        Parameters
        ----------
        attributes : mapping
            JSON-able; a backend may add the key `ARRAYS_IN`: the subgroup with the arrays.
        fill : callable
            Writes the arrays into the group passed to it.
        """

    def zarr_group(self, place: P) -> AbstractContextManager[ZarrAddress]:
        """Yield the address from which Zarr reads a group; errors inside become `StoreError`."""

    def prepare(self, root: P, folders: Sequence[P]) -> None:
        """Prepare a root for writing: make folders, or raise an error if that is impossible."""

    def why_no_store(self, root: P) -> str:
        """Return the reason why the root is not a store, worded to follow "it"."""

    def clean(self, root: P, folders: Sequence[P]) -> None:
        """Remove unfinished files where that is cheap."""

    def free_bytes(self, root: P) -> int | None:
        """Return the free space; None if unknown."""
