"""The home of a service: its paths, its tokens and their roles, and helper processes.

::

    <home>/                     runs, by default
      <job>/                    one study or diagnosis; `palpate status <job>` reads a study too
      store/                    shared by all of them, unless another store is given
      .service/
        queue.jsonl             submitted jobs and their states
        tokens.json             names of tokens, and their SHA-256
        uploads/<folder>/<file> uploaded images and cases

Only the SHA-256 of a token is stored.

======  ==========================================================
read    view jobs, results and files
submit  also upload and submit; stop and change own jobs
admin   also stop and change the jobs of others
======  ==========================================================

The token in the variable PALPATE_TOKEN is an admin. A service removes it from its environment,
so that workers and helpers do not inherit it. Helper processes import nothing from users' folders.
"""

import hashlib
import hmac
import os
import re
import secrets
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.backends.store_paths import Place
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import dumps, loads
from palpate.workers import WORKER_ENVIRONMENT

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,95}$"
_NAME = re.compile(NAME_PATTERN)
RESERVED_NAMES = {"store"}


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


def helper_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a Palpate module without importing from users' folders."""
    return [sys.executable, "-P", "-m", module, *arguments]


def helper_environment() -> dict[str, str]:
    """Return the environment of a helper process, which may run in any folder."""
    environment = os.environ | WORKER_ENVIRONMENT | {"PYTHONSAFEPATH": "1"}
    if given := environment.get("PYTHONPATH"):
        places = [str(Path(place).absolute()) for place in given.split(os.pathsep) if place]
        environment["PYTHONPATH"] = os.pathsep.join(places)
    return environment


TOKEN_VARIABLE = "PALPATE_TOKEN"
TOKEN_FILE_VARIABLE = "PALPATE_TOKEN_FILE"
LEAST_TOKEN_LENGTH = 16
Role = Literal["read", "submit", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)


@dataclass(frozen=True, slots=True)
class Owner:
    """The holder of a token.

    Parameters
    ----------
    name : str
    role : {"read", "submit", "admin"}
    """

    name: str
    role: Role

    @property
    def submits(self) -> bool:
        """Whether this token may upload and submit jobs."""
        return self.role != "read"

    def may_change(self, owner: str) -> bool:
        """Check whether this token may stop and change the jobs of `owner`."""
        return self.role == "admin" or (self.submits and self.name == owner)


def take_token() -> str:
    """Remove the token from the environment and return it.

    Without one, read the file named by the variable PALPATE_TOKEN_FILE, such as a Docker
    secret.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    given, file = os.environ.pop(TOKEN_VARIABLE, ""), os.environ.pop(TOKEN_FILE_VARIABLE, "")
    if given or not file:
        return given
    try:
        return Path(file).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{TOKEN_FILE_VARIABLE} names {file}, which cannot be read: {error}."
        ) from error


class Tokens:
    """Tokens from a file and from the environment.

    Parameters
    ----------
    path : Path
        Reread when it changes, so that tokens can be added while the service runs.
    given : str, optional
        The token from the environment; see `take_token`. Default: read from there.

    Raises
    ------
    StoreError
        If the file is damaged.
    InputError
        If the token from the environment is too short.
    """

    def __init__(self, path: Path, given: str | None = None) -> None:
        self.path = path
        self._stamp: tuple[int, int] | None = None
        self._known: dict[str, tuple[str, Role]] = {}
        given = os.environ.get(TOKEN_VARIABLE, "") if given is None else given
        if given and len(given) < LEAST_TOKEN_LENGTH:
            raise InputError(
                f"{TOKEN_VARIABLE} has {len(given)} characters, expected at least "
                f"{LEAST_TOKEN_LENGTH}. "
                "Create one with: python -c 'import secrets; print(secrets.token_urlsafe())'"
            )
        first: Role = "admin"
        self._environment = {"environment": (_token_hash(given), first)} if given else {}
        self._read()

    def __bool__(self) -> bool:
        self._read()
        return bool(self._known or self._environment)

    @property
    def names(self) -> list[str]:
        """Return the names of all tokens."""
        self._read()
        return sorted(self._known | self._environment)

    @property
    def roles(self) -> dict[str, Role]:
        """Return the role of each token, by name."""
        self._read()
        return {name: role for name, (_, role) in sorted((self._known | self._environment).items())}

    def new(self, name: str, role: Role = "submit") -> str:
        """Create a token and return it; only its hash is stored.

        Raises
        ------
        InputError
            If the name is taken.
        """
        self._read()
        if checked_name(name) in self._known:
            raise InputError(
                f"A token named {name} already exists: remove it with `palpate token remove "
                f"{name}`, or choose another name."
            )
        token = secrets.token_urlsafe(32)
        self._write(self._known | {name: (_token_hash(token), role)})
        return token

    def remove(self, name: str) -> None:
        """Remove a token.

        Raises
        ------
        InputError
            If it does not exist.
        """
        self._read()
        if name not in self._known:
            raise InputError(
                f"There is no token named {name}. Existing tokens: "
                f"{', '.join(sorted(self._known)) or 'none'}."
            )
        self._write({key: value for key, value in self._known.items() if key != name})

    def owner(self, token: str) -> str | None:
        """Return the name of a token; None if it is not known."""
        owner = self.holder(token)
        return None if owner is None else owner.name

    def holder(self, token: str) -> Owner | None:
        """Return the holder of a token, with the role; None if it is unknown."""
        self._read()
        given, owner = _token_hash(token), None
        for name, (known, role) in (self._known | self._environment).items():
            if hmac.compare_digest(given, known):
                owner = Owner(name, role)
        return owner

    def _read(self) -> None:
        try:
            stat = self.path.stat()
        except OSError:
            self._stamp, self._known = None, {}
            return
        if self._stamp == (stat.st_mtime_ns, stat.st_size):
            return
        try:
            known: Any = loads(self.path.read_bytes())["tokens"]
            self._known = {str(name): _token_entry(value) for name, value in known.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(
                f"{self.path} is damaged ({error!r}). Remove it and create new tokens with "
                "`palpate token new NAME`."
            ) from error
        self._stamp = (stat.st_mtime_ns, stat.st_size)

    def _write(self, known: dict[str, tuple[str, Role]]) -> None:
        tokens = {name: {"sha256": value, "role": role} for name, (value, role) in known.items()}
        with explained(self.path), replacing(self.path) as temporary:
            temporary.touch(mode=0o600)
            temporary.write_text(dumps({"tokens": tokens}) + "\n")
        self._read()


def _token_entry(value: Any) -> tuple[str, Role]:
    """Return hash and role; tokens of older versions have the role submit."""
    if isinstance(value, str):
        return value, "submit"
    role = value["role"]
    if role not in ROLES:
        raise ValueError(f"{role!r} is not a role")
    return str(value["sha256"]), role


def _token_hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()
