"""Tokens of a service: whoever has one may write. Only their SHA-256 is kept."""

import hashlib
import hmac
import os
import secrets
from pathlib import Path
from typing import Any

from palpate.service.server.jobs.home import checked_name
from palpate.storage.backends.atomic import explained, replacing
from palpate.storage.errors import InputError, StoreError
from palpate.storage.plain import dumps, loads

ENVIRONMENT = "PALPATE_TOKEN"
LEAST_LENGTH = 16


class Tokens:
    """The tokens in a file, and the one of the environment.

    Parameters
    ----------
    path : Path
        Read again when it changes, so that a token can be added while the service runs.

    Raises
    ------
    StoreError
        If the file is damaged.
    InputError
        If the token of the environment is too short.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stamp: tuple[int, int] | None = None
        self._known: dict[str, str] = {}
        given = os.environ.get(ENVIRONMENT, "")
        if given and len(given) < LEAST_LENGTH:
            raise InputError(
                f"{ENVIRONMENT} has {len(given)} characters, expected at least {LEAST_LENGTH}. "
                "Make one with: python -c 'import secrets; print(secrets.token_urlsafe())'"
            )
        self._environment = {"environment": _hash(given)} if given else {}
        self._read()

    def __bool__(self) -> bool:
        self._read()
        return bool(self._known or self._environment)

    @property
    def names(self) -> list[str]:
        """Return the names of all tokens."""
        self._read()
        return sorted(self._known | self._environment)

    def new(self, name: str) -> str:
        """Make a token and return it; it is written nowhere.

        Raises
        ------
        InputError
            If there is one of that name.
        """
        self._read()
        if checked_name(name) in self._known:
            raise InputError(
                f"There is a token named {name} already: remove it with `palpate token remove "
                f"{name}`, or choose another name."
            )
        token = secrets.token_urlsafe(32)
        self._write(self._known | {name: _hash(token)})
        return token

    def remove(self, name: str) -> None:
        """Forget a token.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        self._read()
        if name not in self._known:
            raise InputError(
                f"There is no token named {name}. Those there are: "
                f"{', '.join(sorted(self._known)) or 'none'}."
            )
        self._write({key: value for key, value in self._known.items() if key != name})

    def owner(self, token: str) -> str | None:
        """Return the name of a token; None if it is not known."""
        self._read()
        given, owner = _hash(token), None
        for name, known in (self._known | self._environment).items():
            if hmac.compare_digest(given, known):
                owner = name
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
            self._known = {str(name): str(value) for name, value in known.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(
                f"{self.path} is damaged ({error!r}). Remove it and make new tokens with "
                "`palpate token new NAME`."
            ) from error
        self._stamp = (stat.st_mtime_ns, stat.st_size)

    def _write(self, known: dict[str, str]) -> None:
        with explained(self.path), replacing(self.path) as temporary:
            temporary.touch(mode=0o600)
            temporary.write_text(dumps({"tokens": known}) + "\n")
        self._read()


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()
