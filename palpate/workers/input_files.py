"""Safe access to input files, with messages for users.

A path may refer to an endless pipe or a device, a file may name other files, and parsers raise
almost any exception on damaged files. Readers use

- `read_bytes` and `read_text`, which open regular files of a limited size,
- `named_by` for each file that another file names,
- `reading`, which converts any exception to one message.
"""

import errno
import logging
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from palpate.storage.errors import InputError, PalpateError

_log = logging.getLogger(__name__)

MIB = 2**20
TEXT_BYTES = 16 * MIB
"""Maximum size of a document: a study, a case, an experiment or a label file."""
_REASON = 300
"""Maximum number of characters of a library's message that are shown."""
_allowed: ContextVar[Path | None] = ContextVar("folder that files may be in", default=None)


@contextmanager
def confined_to(folder: Path) -> Iterator[None]:
    """Refuse input files outside a folder, within the context."""
    token = _allowed.set(folder.resolve())
    try:
        yield
    finally:
        _allowed.reset(token)


def named_by(path: Path, name: str) -> Path:
    """Return the path of a file that another file names, relative to its folder.

    Parameters
    ----------
    path : Path
        File that contains the name.
    name : str

    Raises
    ------
    InputError
        If it is outside the folder that input is confined to, or is not a valid path.
    """
    if "\0" in name:
        raise InputError(f"{path} names the file {name[:60]!r}, which is not a valid file name.")
    named = path.parent / name
    check_allowed(named, f"{path} names {name[:200]!r}, which")
    return named


def check_allowed(path: Path, what: str = "") -> None:
    """Raise InputError if a path is outside the folder that input is confined to."""
    folder = _allowed.get()
    if folder is not None and not path.resolve().is_relative_to(folder):
        raise InputError(
            f"{what or path.name} is outside the uploaded folder. Upload all files of one input "
            "to one folder, and refer to them by name."
        )


def check_regular(path: Path) -> None:
    """Raise InputError if a path exists and is a pipe, a socket or a device.

    Opening a pipe waits for a writer, and a device may never end.
    """
    check_allowed(path)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # the reader reports missing files
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(
            f"{path} is a pipe or a device; a file was expected. Write the data to a file and give "
            "its path."
        )


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read the content of a regular file.

    Raises
    ------
    InputError
        If the path is not a regular file, or the file is larger than `most_bytes`.
    OSError
        If the file cannot be read.
    """
    check_regular(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise InputError(
            f"{path} is larger than {most_bytes / MIB:g} MiB, the limit for such a file. Check "
            "that it is the right one."
        )
    return content


def read_text(path: Path, encoding: str = "utf-8-sig", most_bytes: int = TEXT_BYTES) -> str:
    """Read the text of a document; see `read_bytes`.

    Raises
    ------
    UnicodeDecodeError
        If the content is not text in that encoding.
    """
    return read_bytes(path, most_bytes).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def reading(path: Path | str, kind: str) -> Iterator[None]:
    """Convert any exception raised while reading and checking input to `InputError`.

    Parameters
    ----------
    path : Path or str
        Name of the file, for the message.
    kind : str
        Kind of file, such as ``"NRRD"`` or ``"an experiment"``.
    """
    try:
        yield
    except PalpateError:
        raise
    except MemoryError as error:
        _log.debug("Reading %s has failed.", path, exc_info=True)
        raise InputError(
            f"{path} needs more memory than this machine has. Check its size and resolution, or "
            "give coarser data."
        ) from error
    except RecursionError as error:
        raise InputError(f"{path} is nested too deeply to be {kind}.") from error
    except Exception as error:  # parsers raise almost anything on damaged input
        _log.debug("Reading %s has failed.", path, exc_info=True)
        if isinstance(error, OSError) and error.strerror:  # decompressors raise some without
            raise InputError(f"{path} cannot be read as {kind}: {error.strerror}.") from error
        raise InputError(
            f"{path} cannot be read as {kind}: {reason_of(error)}. It is damaged, cut short or "
            "misnamed; copy or export it again."
        ) from error


def reason_of(error: BaseException) -> str:
    """Return the message of an exception, shortened to one line, or else its type."""
    try:
        text = " ".join(str(error).split())
    except ValueError:  # it contains a number with too many digits
        text = ""
    text = text if len(text) <= _REASON else f"{text[:_REASON]} ..."
    return (text or type(error).__name__).rstrip(".")
