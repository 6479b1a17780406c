r"""The journal from which a study is resumed: an append-only file of JSON records, one per line.

::

    {"kind":"study", ...,"previous":"","checksum":"79360de56fb546c7"}\n
    {"kind":"session", ...,"previous":"79360de56fb546c7","checksum":"0b1d3fa2c4e58697"}\n
    {"kind":"evaluation","cand                   torn: its writer was killed here

A record exists once its newline is on disk. Anything after the last newline is ignored by
readers and cut off by the next writer. There is one writer at a time; it holds a kernel lock
(``flock``), which is released when the process ends, however it ends.

Each line names the line before it, and its checksum covers that name and with it all lines before,
so that none can be removed, repeated or moved. What is missing at the end cannot be noticed: a
writer that was killed leaves the same file. Earlier versions wrote checksums without names, and
before that no checksums. Such lines can only be at the beginning of a file; the first line after
them names the last of them.
"""

import fcntl
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from palpate.storage.backends.atomic_files import NO_LOCKS, NO_LOCKS_ADVICE, hint, read_hint, sync
from palpate.storage.errors import JournalError
from palpate.storage.journal_records import SCHEMA_VERSION
from palpate.storage.json_digests import (
    CHECKSUM_KEY,
    CHECKSUM_LENGTH,
    SEAL_LENGTH,
    ChecksumError,
    dumps,
    line_checksum,
    loads,
    seal,
    unseal,
)
from palpate.storage.store import check_schema

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


LOCK_PATIENCE_S = 1.0


class Journal:
    """Writer of a journal; use as a context manager.

    Parameters
    ----------
    path : Path
        Created if missing; its folder must exist.

    Attributes
    ----------
    last_written : datetime
        Time of the last write before this writer opened the journal.

    Raises
    ------
    JournalError
        If another process is writing this journal, or the file cannot be used.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "journal.jsonl"
    >>> with Journal(path) as journal:
    ...     journal.append({"candidate": 0})
    >>> list(Journal.read(path))
    [{'candidate': 0}]
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._handle = self._open()
        try:
            self._lock()
            self.last_written = datetime.fromtimestamp(os.fstat(self._handle).st_mtime, UTC)
            self._size = self._without_tail()
            self._last_line = line_before(self._handle, self._size)
            sync(self.path.parent)  # puts the name of a new file on disk, too
        except OSError as error:
            self.close()
            raise self._failed("used", error) from error
        except BaseException:
            self.close()
            raise
        self._torn = False

    def append(self, *records: Mapping[str, Any]) -> None:
        """Write records and return once they are on disk; on an error, none is written.

        Parameters
        ----------
        *records : mapping
            Plain JSON values; infinities as texts, as `storage.journal_records` writes them.

        Raises
        ------
        JournalError
            If the disk is full or fails, or another program changed the file. The journal
            then ends with its last whole record.
        ValueError, TypeError
            If a record cannot be written as JSON; nothing is written then.
        """
        if not records:
            return
        if self._handle < 0:
            raise JournalError(f"{self.path} has been closed; open it again to append.")
        chain = LineChain(self._last_line)
        lines = [chain.sealed(record) + b"\n" for record in records]
        data = b"".join(lines)
        try:
            self._check_file()
            _write_all(self._handle, data)
            os.fsync(self._handle)
            self._size += len(data)
            self._last_line = lines[-1]
        except OSError as error:
            self._cut_back()
            raise self._failed("written", error) from error
        except JournalError:
            raise
        except BaseException:
            # Ctrl-C in the middle of a line; the next record must not join its first half.
            self._cut_back()
            raise

    @staticmethod
    def read(path: Path | str) -> Iterator[dict[str, Any]]:
        """Yield every whole record in order; another process may be writing meanwhile.

        See `Journal.lines`.
        """
        return (record for record, _ in Journal.lines(path))

    @staticmethod
    def lines(path: Path | str) -> Iterator[tuple[dict[str, Any], Seal]]:
        """Yield every whole record in order, and what protects it.

        A missing journal has no records.

        Raises
        ------
        JournalError
            If a line is damaged, its checksum is wrong, it does not follow the line before it,
            or the file cannot be read.
        NewerSchemaError
            If a newer version of Palpate wrote a record.
        """
        path = Path(path)
        try:
            file = path.open("rb")
        except FileNotFoundError:
            return
        except OSError as error:
            raise JournalError(
                f"{path} cannot be read: {error.strerror or error}. {read_hint(error)}"
            ) from error
        chain = LineChain()
        with file:
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n"):
                    return
                yield _parse(chain, line, path, number)

    @staticmethod
    def is_being_written(path: Path | str) -> bool:
        """Return True if a process holds the lock of a journal.

        False if there is no journal, or if the file system has no locks (no journal is written
        there).
        """
        try:
            handle = os.open(path, os.O_RDONLY)
        except OSError:
            return False
        try:
            return not _locked(handle, fcntl.LOCK_SH)
        except OSError:
            return False
        finally:
            _unlock_and_close(handle)

    def close(self) -> None:
        """Release the lock; closing twice is harmless."""
        if self._handle >= 0:
            handle, self._handle = self._handle, -1
            _unlock_and_close(handle)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _open(self) -> int:
        try:
            return os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, mode=0o666)
        except OSError as error:
            raise self._failed("opened", error) from error

    def _lock(self) -> None:
        """Take the lock, waiting a moment in case `is_being_written` is holding it."""
        deadline = time.monotonic() + LOCK_PATIENCE_S
        while not self._try_lock():
            if time.monotonic() > deadline:
                raise JournalError(
                    f"{self.path} is being written by another process: this study is already "
                    "running. Follow it with `palpate status`, or stop that process first."
                )
            time.sleep(LOCK_PATIENCE_S / 20)

    def _try_lock(self) -> bool:
        try:
            return _locked(self._handle, fcntl.LOCK_EX)
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            raise JournalError(
                f"{self.path} cannot be locked: {error.strerror or error}. {NO_LOCKS_ADVICE}"
            ) from error

    def _without_tail(self) -> int:
        """Cut off a torn tail and return the size; the time of the last write stays."""
        known = os.fstat(self._handle)
        size = whole_bytes(self._handle, known.st_size)
        if size < known.st_size:
            os.ftruncate(self._handle, size)
            with suppress(OSError):  # only the owner of a file may set its time
                os.utime(self._handle, ns=(known.st_atime_ns, known.st_mtime_ns))
        return size

    def _check_file(self) -> None:
        """Raise an error if the file is no longer the one that was opened."""
        if self._torn:
            os.ftruncate(self._handle, self._size)
            self._torn = False
        mine = os.fstat(self._handle)
        try:
            named = os.stat(self.path)  # noqa: PTH116 - consistent with fstat
        except FileNotFoundError:
            named = None
        if named is None or (named.st_ino, named.st_dev) != (mine.st_ino, mine.st_dev):
            raise JournalError(
                f"{self.path} was moved or replaced while its study was running. Put the journal "
                "back and run the study again to continue."
            )
        if mine.st_size != self._size:
            raise JournalError(
                f"{self.path} was changed by another program while its study was running: it has "
                f"{mine.st_size} bytes, expected {self._size}. Run the study again to continue "
                "from its present content."
            )

    def _cut_back(self) -> None:
        """Undo a failed write; if that fails too, the next `append` tries again."""
        self._torn = True
        with suppress(OSError):
            os.ftruncate(self._handle, self._size)
            self._torn = False

    def _failed(self, what: str, error: OSError) -> JournalError:
        return JournalError(
            f"{self.path} cannot be {what}: {error.strerror or error}. {hint(error)}"
        )


def _locked(handle: int, kind: int) -> bool:
    """Try to take a lock without waiting; False if another process has it."""
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _unlock_and_close(handle: int) -> None:
    """Release the lock for all copies of the handle, then close this one.

    A process that another thread is starting, such as a worker, has a copy between fork and
    exec: closing ours alone would leave the lock with it.
    """
    with suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_UN)
    os.close(handle)


def _write_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]


def _parse(chain: LineChain, line: bytes, path: Path, number: int) -> tuple[dict[str, Any], Seal]:
    try:
        try:
            record, protection = chain.read(line)
        except ChecksumError:
            _check_schema(loads(line), path, number)  # newer versions may sum differently
            raise
        _check_schema(record, path, number)
        return record, protection
    except ValueError as error:
        what = error if isinstance(error, ChecksumError) else f"not a JSON record ({error})"
        kept = f"the {number - 1} lines before it are" if number > 2 else "the line before it is"
        advice = (
            f"{kept} intact: move the journal aside and keep them with `head -n {number - 1} OLD > "
            f"{path.name}`"
            if number > 1
            else "move the journal aside"
        )
        raise JournalError(
            f"{path}, line {number}: {what}. To resume, {advice}, then run "
            "the study again; evaluations in the store are not computed again."
        ) from error


def _check_schema(record: Mapping[str, Any], path: Path, number: int) -> None:
    if "schema_version" in record:
        check_schema(record["schema_version"], SCHEMA_VERSION, f"{path}, line {number},")
