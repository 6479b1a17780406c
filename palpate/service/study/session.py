"""Sessions: workers are opened for one piece of work, stopped by Ctrl-C, and closed."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from distributed import Client

from palpate.service.cluster.dispatch import Dispatcher, TaskRunner
from palpate.service.cluster.open import open_cluster, prepare_client
from palpate.service.cluster.single_process import SingleProcess
from palpate.service.cluster.worker_range import Workers
from palpate.service.errors import Interrupted
from palpate.service.interrupts import stop_requests
from palpate.service.study.observers.dask_records import DaskRecords
from palpate.service.study.observers.hooks import Observer
from palpate.storage.errors import InputError

Runner = TypeVar("Runner", bound=TaskRunner, covariant=True)


@dataclass(frozen=True)
class Session(Generic[Runner]):
    """The workers of a session.

    Parameters
    ----------
    dispatcher : TaskRunner
        Sends tasks to the workers.
    dashboard : str
        Address of Dask's page; empty if there is none.
    observers : tuple of Observer
        Observers for a study that runs on them.
    """

    dispatcher: Runner
    dashboard: str = ""
    observers: tuple[Observer, ...] = ()


@contextmanager
def session(
    scheduler: str | None = None, workers: Workers | str | None = None
) -> Iterator[Session[Dispatcher]]:
    """Open the workers of this machine or connect to a scheduler, until the work is done.

    Ctrl-C and SIGTERM stop the dispatcher, unless the calling program handles these signals
    itself.

    Parameters
    ----------
    scheduler, workers
        See `service.cluster.open.open_cluster`.

    Raises
    ------
    Interrupted
        If the user asks to stop; finished tasks are saved.
    ClusterError, InputError
        As for `open_cluster`.
    """
    with stop_requests(respect_handlers=True) as requests:
        if requests:
            raise Interrupted
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            yield Session(dispatcher, cluster.dashboard, (DaskRecords(cluster.client),))


@contextmanager
def client_session(client: Client) -> Iterator[Session[Dispatcher]]:
    """Use the workers of a client, which stays open; Ctrl-C and SIGTERM as in `session`.

    Raises
    ------
    Interrupted
        If the user asks to stop; finished tasks are saved.
    ClusterError
        If scheduler or workers cannot import Palpate.
    """
    with stop_requests(respect_handlers=True) as requests:
        prepare_client(client)
        dispatcher = Dispatcher(client, stop=lambda: bool(requests))
        yield Session(dispatcher, client.dashboard_link or "", (DaskRecords(client),))


@contextmanager
def in_process_session() -> Iterator[Session[SingleProcess]]:
    """Run all tasks in this process, one at a time; Ctrl-C stops the current one."""
    yield Session(SingleProcess())


def chosen_session(
    *,
    workers: Workers | str | None = None,
    scheduler: str | None = None,
    client: Client | None = None,
    in_process: bool = False,
) -> AbstractContextManager[Session[TaskRunner]]:
    """Return the session for the workers chosen by the caller.

    Parameters
    ----------
    workers, scheduler
        See `session`, which is the default.
    client : distributed.Client, optional
    in_process : bool

    Raises
    ------
    InputError
        If more than one kind of workers is chosen.
    """
    choices = {
        "workers": workers is not None,
        "scheduler": scheduler is not None,
        "client": client is not None,
        "in_process": in_process,
    }
    chosen = [name for name, is_chosen in choices.items() if is_chosen]
    if len(chosen) > 1:
        raise InputError(f"Give one of {' and '.join(chosen)}: each chooses the workers.")
    if client is not None:
        return client_session(client)
    return in_process_session() if in_process else session(scheduler, workers)
