"""All paths of a study and of a store.

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

A study is a local folder; a store is a local folder or part of a bucket. See
`storage.backends.places`.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from palpate.storage.backends.places import Place
from palpate.storage.errors import StoreError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


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
        """Return the path of the journal; see `storage.records.journal`."""
        return self.root / "journal.jsonl"

    @property
    def findings(self) -> Path:
        """Return the path of the findings about the fitted body; see `workers.organs.registry`."""
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
        return self.volumes / f"{_checked(digest)}.zarr"

    def mesh(self, digest: str) -> Place:
        """Return the path of one mesh hierarchy."""
        return self.meshes / f"{_checked(digest)}.zarr"

    def field(self, digest: str) -> Place:
        """Return the path of one displacement field."""
        return self.fields / f"{_checked(digest)}.zarr"

    def lock(self, name: str) -> Place:
        """Return the path of one lock; see `storage.stores.lock`."""
        return self.locks / f"{_checked(name)}.json"

    def evaluation(self, digest: str) -> Place:
        """Return the path of one finished evaluation."""
        return self.evaluations / f"{_checked(digest)}.json"

    def overrun(self, digest: str, number: int) -> Place:
        """Return the path of the file that marks the n-th overrun of an evaluation."""
        return self.root / "overruns" / f"{_checked(digest)}-{number}"


def _checked(digest: str) -> str:
    if not _NAME.fullmatch(digest):
        raise StoreError(
            f"{digest!r} is not a valid name: expected a digest of letters and digits, "
            "such as 3f2a9c0d1b7e6a54."
        )
    return digest
