"""Streams of bzip2, of which nothing is skipped in silence.

`bz2.BZ2File` ignores what follows a stream, such as a second one whose first byte has changed.
Here only zeros are ignored, as in `gzip.GzipFile`.
"""

import bz2
import io
from typing import Any, BinaryIO

_BLOCK_BYTES = 2**16


class Bzip2Stream(io.RawIOBase):
    """Content of bzip2 data, which, unlike in `bz2.BZ2File`, only zeros may follow.

    Parameters
    ----------
    file : binary file
        Positioned at the beginning of the data.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._stream = bz2.BZ2Decompressor()
        self._held = b""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer, and return the number of bytes; see `io.RawIOBase`."""
        part = b""
        while not part and not (self._stream.eof and self._nothing_follows()):
            if self._stream.needs_input and not self._held:
                self._held = self._file.read(_BLOCK_BYTES)
                if not self._held:
                    raise EOFError("its compressed data have no end")
            part = self._stream.decompress(self._held, len(buffer))
            self._held = b""
        buffer[: len(part)] = part
        return len(part)

    def _nothing_follows(self) -> bool:
        """Skip zeros after a stream; begin the next one, unless the file ends."""
        self._held = self._stream.unused_data.lstrip(b"\0")
        while not self._held and (block := self._file.read(_BLOCK_BYTES)):
            self._held = block.lstrip(b"\0")
        if self._held:
            self._stream = bz2.BZ2Decompressor()
        return not self._held
