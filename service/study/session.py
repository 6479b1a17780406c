"""Workers for one piece of work: opened, told to stop by Ctrl-C, closed again."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from palpate.service.cluster.dispatch import Dispatcher
from palpate.service.cluster.open import open_cluster
from palpate.service.cluster.worker_range import Workers
from palpate.service.errors import Interrupted
from palpate.service.interrupts import stop_requests
from palpate.service.study.observers.dask_records import DaskRecords
from palpate.service.study.observers.hooks import Observer


@dataclass(frozen=True)
class Session:
    """Workers that are at hand.

    Parameters
    ----------
    dispatcher : Dispatcher
        Sends tasks to them.
    dashboard : str
        Address of Dask's page; empty if there is none.
    observers : tuple of Observer
        Of a study that runs on them.
    """

    dispatcher: Dispatcher
    dashboard: str = ""
    observers: tuple[Observer, ...] = ()


@contextmanager
def session(
    scheduler: str | None = None, workers: Workers | str | None = None
) -> Iterator[Session]:
    """Open the workers of this machine or connect to a scheduler, until the work is done.

    Ctrl-C and SIGTERM stop the dispatcher; the signals of a program that handles them itself
    stay with it.

    Parameters
    ----------
    scheduler, workers
        See `service.cluster.open.open_cluster`.

    Raises
    ------
    Interrupted
        If the user asks to stop; finished tasks are saved.
    ClusterError, InputError
        As `open_cluster`.
    """
    with stop_requests(respect_handlers=True) as requests:
        if requests:
            raise Interrupted
        with open_cluster(scheduler, workers) as cluster:
            dispatcher = Dispatcher(cluster.client, stop=lambda: bool(requests))
            yield Session(dispatcher, cluster.dashboard, (DaskRecords(cluster.client),))
