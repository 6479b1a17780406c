"""Detection of workers that cannot run Palpate, or run another version of it."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from distributed import Client

from palpate.service.errors import ClusterError
from palpate.service.versions import palpate_version
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
    text = " ".join(str(one) for one in _chain(error))
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
