"""Translation of exceptions from Dask and workers into errors that a user can act on."""

import errno

from distributed import KilledWorker

from palpate.service.cluster.foreign_workers import raise_if_foreign
from palpate.service.errors import ClusterError
from palpate.storage.backends.atomic import hint
from palpate.storage.errors import StoreError

FULL_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}


class as_cluster_error:  # noqa: N801 - a context manager
    """Explain the exceptions that Dask raises once the scheduler is gone."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            raise_if_foreign(error)
        if isinstance(error, OSError | TimeoutError | RuntimeError):
            raise scheduler_gone(sentence(error)) from error


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


def death(killed: KilledWorker) -> str:
    """Describe how the workers of a task died."""
    worker = getattr(killed, "last_worker", None)
    name = getattr(worker, "address", None) or "unknown"
    deaths = killed.allowed_failures + 1 if hasattr(killed, "allowed_failures") else "several"
    return f"its worker died every time, {deaths} deaths in the last attempt; last worker {name}"


def sentence(error: BaseException) -> str:
    """Return the type and message of an error."""
    text = str(error).strip() or "no message"
    return f"{type(error).__name__}: {text}"
