"""Atomic writes: a name appears only when everything it refers to is on disk.

::

    write .tmp-<pid>-<random>-<name>  >  fsync  >  rename to <name>  >  fsync the folder

A writer that is killed leaves a temporary name behind; readers ignore it and
`clean_leftovers` removes it. The rename is atomic on a local file system and on
NFS, so two writers of the same name cannot mix.
"""

import errno
import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from palpate.storage.errors import StoreError

PREFIX = ".tmp-"
DAY_S = 86_400.0
LONGEST_TAIL = 120  # characters of the final name kept in a temporary one; names end at 255

_HINTS = {
    errno.ENOSPC: "The disk is full: free some space and run the command again.",
    errno.EDQUOT: "Your disk quota is used up: free some space and run the command again.",
    errno.EROFS: "The file system is read-only: choose another place.",
    errno.EACCES: "You may not write there: choose another place or change its permissions.",
    errno.EPERM: "You may not write there: choose another place or change its permissions.",
    errno.ENOTDIR: "Part of this path is a file, not a folder: choose another place.",
    errno.ENOENT: "The folder does not exist: was it moved or removed?",
    errno.EISDIR: "A folder already has that name: choose another name.",
    errno.ENAMETOOLONG: "The name is too long: choose a shorter one.",
    errno.ELOOP: "Symbolic links form a loop: choose another place.",
    errno.EMFILE: "Too many files are open: raise the limit with `ulimit -n 4096` and try again.",
    errno.ENFILE: "Too many files are open on this machine: close some programs and try again.",
    errno.EFBIG: "The file system cannot hold a file of that size: choose another place.",
    errno.EIO: "The disk reports an error: check it, or choose another place.",
    errno.ESTALE: "The network file system has lost this folder: mount it again and try again.",
    errno.ETIMEDOUT: "The network file system does not respond: check the network and try again.",
}
NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
"""Errors raised by file systems without file locks."""
NO_LOCKS_ADVICE = (
    "This file system has no file locks, without which two runs could write the same file. Choose "
    "a folder on a local disk, or mount it with locks (NFS: without `nolock`; Lustre: `flock`)."
)
# Errors of file systems that cannot fsync a folder.
_NO_FOLDER_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF}


def hint(error: OSError) -> str:
    """Return advice for a failed write."""
    return _HINTS.get(
        error.errno or 0, "Choose another place, or ask the administrator of this file system."
    )


def read_hint(error: OSError) -> str:
    """Return advice for a failed read."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return "You may not read it: change its permissions."
    return hint(error)


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn an ``OSError`` from a write to `path` into a `StoreError` with advice."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"Cannot write {path}: {error.strerror or error}. {hint(error)}"
        ) from error


def temporary_sibling(path: Path) -> Path:
    """Return a new name in the folder of `path`, with the same suffix, that readers ignore."""
    tail = path.name[-LONGEST_TAIL:]
    return path.with_name(f"{PREFIX}{os.getpid()}-{secrets.token_hex(4)}-{tail}")


def is_temporary(path: Path) -> bool:
    """Return True if `path` is the temporary name of an unfinished file or folder."""
    return path.name.startswith(PREFIX)


def write_file(path: Path, data: bytes) -> None:
    """Write a whole file or nothing, replacing an older file of that name.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    with explained(path), replacing(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file name, which becomes `path` unless an error is raised."""
    temporary = temporary_sibling(path)
    try:
        yield temporary
        sync(temporary)
        temporary.replace(path)
    except BaseException:
        discard(temporary)
        raise
    sync(path.parent)


@contextmanager
def publishing(path: Path) -> Iterator[Path]:
    """Yield a temporary folder name, which becomes `path` unless an error is raised.

    If another writer publishes `path` first, that result is kept and ours is discarded.
    """
    temporary = temporary_sibling(path)
    try:
        yield temporary
        for folder, _, names in os.walk(temporary):
            for name in names:
                sync(Path(folder, name))
            sync(Path(folder))
        try:
            os.rename(temporary, path)  # noqa: PTH104 - the one call that publishes
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            discard(temporary)
    except BaseException:
        discard(temporary)
        raise
    sync(path.parent)


def sync(path: Path) -> None:
    """Flush a file or a folder to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if not (path.is_dir() and error.errno in _NO_FOLDER_SYNC):
            raise
    finally:
        os.close(handle)


def discard(path: Path) -> None:
    """Remove a file or a folder, ignoring errors."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def withdraw(path: Path) -> bool:
    """Remove a published folder in one step, so that readers never see half of it.

    Return False if it does not exist.
    """
    if not path.exists():
        return False
    temporary = temporary_sibling(path)
    with explained(path):
        try:
            os.rename(path, temporary)  # noqa: PTH104 - removes the name in one step
        except FileNotFoundError:
            return False
        discard(temporary)
    return True


def clean_leftovers(folder: Path, *, older_than_s: float = DAY_S) -> None:
    """Remove temporary names in `folder` that are too old to be in use."""
    oldest = time.time() - older_than_s
    try:
        entries = [entry for entry in os.scandir(folder) if entry.name.startswith(PREFIX)]
    except OSError:
        return
    for entry in entries:
        with suppress(OSError):
            if entry.stat(follow_symlinks=False).st_mtime < oldest:
                discard(Path(entry.path))
