"""Checksums of records that are one line of JSON.

The checksum is the last field of the record and covers every byte before it, so a digit that
changed is found even where it would be read as the same number. Records of earlier versions carry
none: they can be read, but not verified.
"""

import hashlib
from typing import Any

from palpate.storage.plain import loads

KEY = "checksum"
LENGTH = 16


class ChecksumError(ValueError):
    """A record differs from what was written."""


def seal(text: str) -> str:
    """Return a JSON object, written without blanks at its ends, with its checksum added.

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
        False for a record of an earlier version, which carries no checksum.

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
