"""Spells every path of a service, once.

::

    <home>/                     runs, by default
      <job>/                    one study or diagnosis; `palpate status <job>` reads a study too
      store/                    shared by all of them, unless another store is given
      .service/
        queue.jsonl             what was submitted, and what became of it
        tokens.json             names of tokens, and their SHA-256
        uploads/<folder>/<file> images and cases that were uploaded
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
        Absolute.
    store : Path or ObjectPath
        Which all workers see.
    """

    root: Path
    store: Place

    @property
    def own(self) -> Path:
        """Return the folder of what is the service's own."""
        return self.root / ".service"

    @property
    def queue(self) -> Path:
        """Return the path of the journal of the queue."""
        return self.own / "queue.jsonl"

    @property
    def tokens(self) -> Path:
        """Return the path of the tokens."""
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
            If it cannot be the name of a job.
        """
        return self.root / checked_name(identifier)

    def make(self) -> None:
        """Make the folders that are missing.

        Raises
        ------
        StoreError
            If they cannot be written.
        """
        with explained(self.root):
            for folder in (self.root, self.own, self.uploads):
                folder.mkdir(parents=True, exist_ok=True)
            self.own.chmod(0o700)


def checked_name(name: str) -> str:
    """Return a name if it is one: no path, nothing hidden.

    Raises
    ------
    InputError
    """
    if not _NAME.match(name) or name.endswith("\n") or ".." in name:
        raise InputError(
            f"{name!r} cannot be a name: expected letters, digits, dots, dashes and underscores, "
            "at most 96, beginning with a letter or a digit."
        )
    return name


def inside(folder: Path, path: Path) -> Path:
    """Return `path` if it lies in `folder`, links resolved.

    Raises
    ------
    StoreError
        If it leads elsewhere.
    """
    if not path.resolve().is_relative_to(folder.resolve()):
        raise StoreError(f"{path.name} leads out of the folder of the service.")
    return path
