"""Lines of JSON that name the line before them, so that none can be removed, repeated or moved.

::

    {"kind":"study", ...,"previous":"","checksum":"79360de56fb546c7"}
    {"kind":"session", ...,"previous":"79360de56fb546c7","checksum":"0b1d3fa2c4e58697"}

Each checksum covers the name of the previous line, and with it all lines before. What is missing
at the end cannot be noticed: a writer that was killed leaves the same file.

Earlier versions wrote checksums without names, and before that no checksums. Such lines can only
be at the beginning of a file; the first line after them names the last of them.
"""

import os
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from palpate.storage.json_digests import (
    CHECKSUM_KEY,
    CHECKSUM_LENGTH,
    SEAL_LENGTH,
    ChecksumError,
    dumps,
    line_checksum,
    seal,
    unseal,
)

PREVIOUS_KEY = "previous"
BLOCK = 65_536

_CHECKSUM = f'"{CHECKSUM_KEY}":"'.encode()
_PREVIOUS = f'"{PREVIOUS_KEY}":"'.encode()


class Seal(StrEnum):
    """What protects a line."""

    NONE = "none"
    CHECKSUM = "checksum"
    CHAIN = "chain"


class LineChain:
    """The lines of one file, in order.

    Parameters
    ----------
    last : bytes
        The line before the first one to be read or written; empty at the beginning of a file.

    Examples
    --------
    >>> writer, reader = LineChain(), LineChain()
    >>> lines = [writer.sealed({"candidate": number}) for number in range(3)]
    >>> [reader.read(line)[0] for line in lines]
    [{'candidate': 0}, {'candidate': 1}, {'candidate': 2}]
    """

    def __init__(self, last: bytes = b"") -> None:
        self._chained = _PREVIOUS in last[-3 * SEAL_LENGTH :]  # the last but one of its fields
        self._last = _name(last) if last else ""

    def sealed(self, record: Mapping[str, Any]) -> bytes:
        """Return the next line of a file."""
        line = seal(dumps({**record, PREVIOUS_KEY: self._last})).encode()
        self._last = _name(line)
        return line

    def read(self, line: bytes) -> tuple[dict[str, Any], Seal]:
        """Return the record in the next line, verified, and what protects it.

        Raises
        ------
        ValueError
            If the text is not a JSON object.
        ChecksumError
            If its checksum is wrong, or it does not follow the line before it.
        """
        record, verified = unseal(line)
        previous = record.pop(PREVIOUS_KEY, None)
        beginning, expected = not self._last, self._last
        if previous is None and self._chained:
            raise ChecksumError(
                "it does not name the line before it, as lines of this journal do: it was "
                "added by another program"
            )
        if previous is not None and (previous != expected or not verified):
            raise ChecksumError(
                "it is not the first line of its journal: the lines before it are missing"
                if beginning
                else "it does not follow the line before it: lines were removed, repeated, "
                "reordered or added here"
            )
        self._last = _name(line)
        if previous is None:
            return record, Seal.CHECKSUM if verified else Seal.NONE
        self._chained = True
        return record, Seal.CHAIN


def line_before(handle: int, end: int) -> bytes:
    """Return the line of an open file that ends at byte `end`; empty if none ends there."""
    if end < 1 or os.pread(handle, 1, end - 1) != b"\n":
        return b""
    start = whole_bytes(handle, end - 1)
    return os.pread(handle, end - start, start)


def whole_bytes(handle: int, end: int) -> int:
    """Return the size of the first `end` bytes of a file up to and including their last newline."""
    while end > 0:
        start = max(end - BLOCK, 0)
        newline = os.pread(handle, end - start, start).rfind(b"\n")
        if newline >= 0:
            return start + newline + 1
        end = start
    return 0


def _name(line: bytes) -> str:
    """Return the checksum in a line, or that of a line which contains none."""
    text = line.strip()
    if text[-SEAL_LENGTH:].startswith(_CHECKSUM):
        return text[-CHECKSUM_LENGTH - 2 : -2].decode(errors="replace")
    return line_checksum(text)
