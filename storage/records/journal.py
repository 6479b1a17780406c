r"""Appends to the file that a study is resumed from: JSON records, one a line.

::

    {"kind":"study", ...}\n
    {"kind":"evaluation","candidate":0, ...}\n
    {"kind":"evaluation","cand                   torn: its writer was killed here

A record exists once its newline is on disk. What follows the last newline never
happened: readers pass it over and the next writer cuts it off. There is one writer
at a time; the kernel holds its lock (``flock``) and drops it when the process ends,
however it ends.
"""

import fcntl
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from palpate.storage.backends.atomic import NO_LOCKS, NO_LOCKS_ADVICE, hint, read_hint, sync
from palpate.storage.errors import JournalError
from palpate.storage.plain import dumps, loads
from palpate.storage.records.record import SCHEMA_VERSION
from palpate.storage.records.seal import ChecksumError, seal, unseal
from palpate.storage.stores.store import check_schema

BLOCK = 65_536
LOCK_PATIENCE_S = 1.0


class Journal:
    """Append records to a journal durably; use as a context manager.

    Parameters
    ----------
    path : Path
        Made when missing; its folder exists.

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
            self._size = _whole_bytes(self._handle)
            os.ftruncate(self._handle, self._size)
            sync(self.path.parent)  # so that the name of a new file is on disk, too
        except OSError as error:
            self.close()
            raise self._failed("used", error) from error
        except BaseException:
            self.close()
            raise
        self._torn = False

    def append(self, *records: Mapping[str, Any]) -> None:
        """Write records and return when they are on disk; all of them or, on an error, none.

        Parameters
        ----------
        *records : mapping
            Plain JSON values; infinities as texts, as `storage.records.record` writes them.

        Raises
        ------
        JournalError
            If the disk is full or fails, or the file was changed by others. The journal
            then ends with its last whole record.
        ValueError, TypeError
            If JSON cannot hold a record; nothing is written then.
        """
        if not records:
            return
        if self._handle < 0:
            raise JournalError(f"{self.path} has been closed; open it again to append.")
        data = "".join(seal(dumps(record)) + "\n" for record in records).encode()
        try:
            self._check_file()
            _write_all(self._handle, data)
            os.fsync(self._handle)
            self._size += len(data)
        except OSError as error:
            self._cut_back()
            raise self._failed("written", error) from error
        except JournalError:
            raise
        except BaseException:
            # Ctrl-C in the middle of a line; what follows must not join its first half.
            self._cut_back()
            raise

    @staticmethod
    def read(path: Path | str) -> Iterator[dict[str, Any]]:
        """Give every whole record in order; another process may be writing meanwhile.

        See `Journal.lines`.
        """
        return (record for record, _ in Journal.lines(path))

    @staticmethod
    def lines(path: Path | str) -> Iterator[tuple[dict[str, Any], bool]]:
        """Give every whole record in order, and whether its checksum was verified.

        A journal that is not there yet has no records. Records of earlier versions carry no
        checksum.

        Raises
        ------
        JournalError
            If a line is damaged, its checksum is wrong, or the file cannot be read.
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
        with file:
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n"):
                    return
                yield _parse(line, path, number)

    @staticmethod
    def is_being_written(path: Path | str) -> bool:
        """Return whether a process holds the lock of a journal.

        False if there is no journal, or on a file system without locks, where none is written.
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
        """Release the lock; closing twice does no harm."""
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
        """Take the lock; `is_being_written` may hold it for an instant, a writer for long."""
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

    def _check_file(self) -> None:
        """Notice when the file is no longer the one that was opened."""
        if self._torn:
            os.ftruncate(self._handle, self._size)
            self._torn = False
        mine = os.fstat(self._handle)
        try:
            named = os.stat(self.path)  # noqa: PTH116 - beside fstat
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
                "from what it holds."
            )

    def _cut_back(self) -> None:
        """Forget a write that failed; should that fail too, the next `append` tries again."""
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
    """Give the lock back for all copies of the handle, then close this one.

    A process that another thread is just starting, such as a worker, has a copy between
    fork and exec: closing ours alone would leave the lock with it.
    """
    with suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_UN)
    os.close(handle)


def _write_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]


def _whole_bytes(handle: int) -> int:
    """Return the size of a file up to and including its last newline."""
    end = os.fstat(handle).st_size
    while end > 0:
        start = max(end - BLOCK, 0)
        newline = os.pread(handle, end - start, start).rfind(b"\n")
        if newline >= 0:
            return start + newline + 1
        end = start
    return 0


def _parse(line: bytes, path: Path, number: int) -> tuple[dict[str, Any], bool]:
    try:
        try:
            record, verified = unseal(line)
        except ChecksumError:
            _check_schema(loads(line), path, number)  # a newer version may sum up in another way
            raise
        _check_schema(record, path, number)
        return record, verified
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
