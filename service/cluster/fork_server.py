"""Starts the worker processes of this machine as copies of one that has done their imports.

A worker that is spawned imports for one and a half seconds before its first task, each for itself.
The fork server of Python's multiprocessing imports once, in a process of its own while the command
still reads its input; a copy of it is there in a tenth of a second, and one that replaces a worker
which died as well. The fork server ends with the command, whether a worker was asked for or not.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, resource_tracker, set_forkserver_preload

from palpate.workers import WORKER_ENVIRONMENT

METHOD = "distributed.worker.multiprocessing-method"
SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def forked_workers(scheduler: str | None, *modules: str) -> Iterator[None]:
    """Start to import modules; workers of the clusters that are opened within have them.

    Only on Linux: elsewhere libraries of the system do not outlive a fork, workers are spawned.

    Parameters
    ----------
    scheduler : str or None
        Address of the cluster that is used instead of this machine; nothing is imported then.
    *modules : str
        Dotted names. Nothing that they do when they are imported may start a thread.
    """
    if scheduler is not None or sys.platform != "linux":
        yield
        return
    _start(modules)
    import dask  # takes a while, in which the fork server is busy already

    with dask.config.set({METHOD: "forkserver"}):
        yield


def _start(modules: tuple[str, ...]) -> None:
    set_forkserver_preload(list(modules))
    os.environ.update(WORKER_ENVIRONMENT)  # read when NumPy is loaded, and when a process starts
    with unheard_interrupts(), _safe_path():
        forkserver.ensure_running()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep modules in the user's folder from being imported in the place of installed ones."""
    is_set = SAFE_PATH in os.environ
    os.environ.setdefault(SAFE_PATH, "1")
    try:
        yield
    finally:
        if not is_set:
            del os.environ[SAFE_PATH]


@contextmanager
def unheard_interrupts() -> Iterator[None]:
    """Keep Ctrl-C from processes that are started within; ours comes when it is over.

    A terminal sends SIGINT to all processes of a command. The driver is the one to
    answer it. Threads and processes inherit the mask, workers that are restarted later too.
    """
    resource_tracker.ensure_running()  # started later it would lift the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
