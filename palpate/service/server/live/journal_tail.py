"""Reader of a growing journal."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError, JournalError
from palpate.storage.records.seal import unseal

READ_BYTES = 256 * 1024


@dataclass(frozen=True)
class JournalLine:
    """A record and the offset of the next one.

    Parameters
    ----------
    end : int
        Bytes of the journal up to and including this record.
    record : dict
    """

    end: int
    record: dict[str, Any]


class JournalTail:
    """New records of a journal, starting at an offset.

    Parameters
    ----------
    path : Path
        Need not exist yet.
    offset : int
        In bytes: 0, or the `JournalLine.end` of a record.

    Raises
    ------
    InputError
        If no record begins there.
    """

    def __init__(self, path: Path, offset: int = 0) -> None:
        self.path, self.offset = path, offset
        if offset and not self._begins_line():
            raise InputError(
                f"No record begins at byte {offset} of this journal: start again from 0."
            )

    def read(self, most_bytes: int = READ_BYTES) -> list[JournalLine]:
        """Return complete unread records, if any.

        Raises
        ------
        JournalError
            If a line is damaged.
        """
        lines: list[JournalLine] = []
        try:
            with self.path.open("rb") as file:
                file.seek(self.offset)
                for line in file.readlines(most_bytes):
                    if not line.endswith(b"\n"):
                        break
                    record = self._parsed(line)
                    self.offset += len(line)
                    lines.append(JournalLine(self.offset, record))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise JournalError(f"{self.path} cannot be read: {error.strerror}.") from error
        return lines

    def _parsed(self, line: bytes) -> dict[str, Any]:
        try:
            record, _ = unseal(line)
        except ValueError as error:
            raise JournalError(
                f"{self.path} is damaged after byte {self.offset}: {error}. "
                "`palpate status` explains how to repair it."
            ) from error
        return record

    def _begins_line(self) -> bool:
        try:
            with self.path.open("rb") as file:
                file.seek(self.offset - 1)
                return file.read(1) == b"\n"
        except (OSError, ValueError, OverflowError):
            return False
