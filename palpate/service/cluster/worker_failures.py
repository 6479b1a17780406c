"""What goes wrong on workers, as errors that a user can act on.

Workers may lack Palpate, run another version of it, die, or be unable to write to the store;
the scheduler may disappear. Exceptions from Dask and from workers are translated here.
"""

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager

from distributed import Client, KilledWorker

from palpate.service.errors_and_interrupts import ClusterError
from palpate.service.installed_packages import palpate_version
from palpate.storage.backends.atomic_files import hint
from palpate.storage.errors import StoreError
from palpate.workers.resources import OneThread

_OWN = r"(?:palpate|service|workers|storage)(?:\.[\w.]+)?"
_MISSING = re.compile(rf"No module named ['\"]{_OWN}['\"]")
_DIFFERENT = re.compile(
    rf"cannot import name .+ from '{_OWN}'|[Cc]an't get attribute .+ on <module '{_OWN}'"
    rf"|module '{_OWN}' has no attribute"
)


def prepare_workers(client: Client) -> None:
    """Limit every current and future worker of a cluster to one thread.

    Raises
    ------
    ClusterError
        If the scheduler or a worker cannot import Palpate.
    """
    with explained_imports():
        client.register_plugin(OneThread())


@contextmanager
def explained_imports() -> Iterator[None]:
    """Replace the error of a worker that cannot import Palpate with advice."""
    try:
        yield
    except Exception as error:
        raise_if_foreign(error)
        raise


def raise_if_foreign(error: BaseException) -> None:
    """Raise an error if a worker lacks Palpate or has another version of it.

    Raises
    ------
    ClusterError
    """
    text = " ".join(str(cause) for cause in _chain(error))
    what = _MISSING.search(text) or _DIFFERENT.search(text)
    if what is None:
        return
    has = "have no Palpate" if _MISSING.search(text) else "have another version of Palpate"
    raise ClusterError(
        f"Some workers, or the scheduler, {has} ({what[0]}). Install Palpate {palpate_version()} "
        "in their Python environment, as on this machine, restart them, and run the same command "
        "again; completed work is kept."
    ) from error


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


FULL_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}


class as_cluster_error:  # noqa: N801 - a context manager
    """Explain the exceptions that Dask raises once the scheduler is gone."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            raise_if_foreign(error)
        if isinstance(error, OSError | TimeoutError | RuntimeError):
            raise scheduler_gone(error_sentence(error)) from error


def scheduler_gone(what: str) -> ClusterError:
    """Return the error for a scheduler that cannot be reached."""
    return ClusterError(
        f"The scheduler can no longer be reached: {what}. Completed work is kept: run the "
        "same command again to continue."
    )


def raise_if_store(error: BaseException) -> None:
    """Raise errors that are unrelated to the task: an unusable store, a full disk.

    Raises
    ------
    StoreError
    """
    if isinstance(error, StoreError):
        raise error
    if isinstance(error, OSError) and error.errno in FULL_DISK:
        raise StoreError(
            f"A worker cannot write to the store: {error}. {hint(error)} Completed work is kept."
        ) from error


def death_reason(killed: KilledWorker) -> str:
    """Describe how the workers of a task died."""
    worker = getattr(killed, "last_worker", None)
    name = getattr(worker, "address", None) or "unknown"
    deaths = killed.allowed_failures + 1 if hasattr(killed, "allowed_failures") else "several"
    return f"its worker died every time, {deaths} deaths in the last attempt; last worker {name}"


def error_sentence(error: BaseException) -> str:
    """Return the type and message of an error."""
    text = str(error).strip() or "no message"
    return f"{type(error).__name__}: {text}"
