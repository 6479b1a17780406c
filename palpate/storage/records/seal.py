"""Checksums of records written as one line of JSON.

The checksum is the last field of the record and covers every byte before it, so a changed digit
is found even if it parses to the same number. Records of earlier versions have none: they can be
read, but not verified.
"""

import hashlib
from typing import Any

from palpate.storage.plain import loads

KEY = "checksum"
LENGTH = 16


class ChecksumError(ValueError):
    """A record that differs from the one written."""


def seal(text: str) -> str:
    """Add a checksum to a JSON object, written without surrounding whitespace.

    Examples
    --------
    >>> seal('{"candidate":0}')
    '{"candidate":0,"checksum":"79360de56fb546c7"}'
    """
    body = text[:-1]
    comma = "" if body == "{" else ","
    return f'{body}{comma}"{KEY}":"{_checksum(body)}"}}'


def unseal(line: str | bytes) -> tuple[dict[str, Any], bool]:
    """Read a record and verify its checksum.

    Returns
    -------
    record : dict
        Without its checksum.
    verified : bool
        False for a record of an earlier version, which has no checksum.

    Raises
    ------
    ValueError
        If the text is not a JSON object.
    ChecksumError
        If its checksum is wrong.
    """
    record = loads(line)
    if not isinstance(record, dict):
        raise ValueError("not an object")
    if KEY not in record:
        return record, False
    text = (line if isinstance(line, str) else line.decode()).strip()
    body = text[: text.rfind(f'"{KEY}"')].removesuffix(",")
    del record[KEY]
    if text != seal(body + "}"):
        raise ChecksumError("its checksum is wrong, so something in it has changed")
    return record, True


def _checksum(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()[:LENGTH]
