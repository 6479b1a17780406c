"""Paths of a service.

::

    <home>/                     runs, by default
      <job>/                    one study or diagnosis; `palpate status <job>` reads a study too
      store/                    shared by all of them, unless another store is given
      .service/
        queue.jsonl             submitted jobs and their states
        tokens.json             names of tokens, and their SHA-256
        uploads/<folder>/<file> uploaded images and cases
"""

import re
from dataclasses import dataclass
from pathlib import Path

from palpate.storage.backends.atomic import explained
from palpate.storage.backends.places import Place
from palpate.storage.errors import InputError, StoreError

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,95}$"
_NAME = re.compile(NAME_PATTERN)
RESERVED = {"store"}


@dataclass(frozen=True, slots=True)
class ServiceHome:
    """The folder of a service.

    Parameters
    ----------
    root : Path
        Absolute path.
    store : Path or ObjectPath
        Must be visible to all workers.
    """

    root: Path
    store: Place

    @property
    def own(self) -> Path:
        """Return the folder of the service's own files."""
        return self.root / ".service"

    @property
    def queue(self) -> Path:
        """Return the path of the journal of the queue."""
        return self.own / "queue.jsonl"

    @property
    def tokens(self) -> Path:
        """Return the path of the token file."""
        return self.own / "tokens.json"

    @property
    def uploads(self) -> Path:
        """Return the folder of uploads."""
        return self.own / "uploads"

    def job(self, identifier: str) -> Path:
        """Return the folder of a job.

        Raises
        ------
        InputError
            If it is not a valid name of a job.
        """
        return self.root / checked_name(identifier)

    def make(self) -> None:
        """Create missing folders.

        Raises
        ------
        StoreError
            If they cannot be created.
        """
        with explained(self.root):
            for folder in (self.root, self.own, self.uploads):
                folder.mkdir(parents=True, exist_ok=True)
            self.own.chmod(0o700)


def checked_name(name: str) -> str:
    """Return a name after checking that it is neither a path nor hidden.

    Raises
    ------
    InputError
    """
    if not _NAME.match(name) or name.endswith("\n") or ".." in name:
        raise InputError(
            f"{name!r} is not a valid name: expected at most 96 letters, digits, dots, dashes "
            "and underscores, beginning with a letter or a digit."
        )
    return name


def inside(folder: Path, path: Path) -> Path:
    """Return `path` if it is inside `folder` with links resolved.

    Raises
    ------
    StoreError
        If it points elsewhere.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        raise StoreError(f"{path.name} points outside the folder of the service.")
    return path
