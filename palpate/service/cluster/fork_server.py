"""Worker processes forked from one that has already done their imports.

A spawned worker spends one and a half seconds on imports before its first task. The fork
server of Python's multiprocessing imports once, in a separate process, while the command still
reads its input; forking a copy takes a tenth of a second, even when it replaces a worker that died.
The fork server ends with the command, whether or not a worker was started.
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
    """Start importing modules; workers of clusters opened within this context have them loaded.

    Only on Linux: elsewhere system libraries do not survive a fork, and workers are spawned.

    Parameters
    ----------
    scheduler : str or None
        Address of a cluster used instead of this machine; nothing is imported then.
    *modules : str
        Dotted names. Importing them must not start a thread.
    """
    if scheduler is not None or sys.platform != "linux":
        yield
        return
    _start(modules)
    import dask  # slow; meanwhile the fork server is already importing

    with dask.config.set({METHOD: "forkserver"}):
        yield


def _start(modules: tuple[str, ...]) -> None:
    set_forkserver_preload(list(modules))
    os.environ.update(WORKER_ENVIRONMENT)  # read when NumPy is loaded, and at process start
    with unheard_interrupts(), _safe_path():
        forkserver.ensure_running()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Prevent modules in the user's folder from shadowing installed ones."""
    is_set = SAFE_PATH in os.environ
    os.environ.setdefault(SAFE_PATH, "1")
    try:
        yield
    finally:
        if not is_set:
            del os.environ[SAFE_PATH]


@contextmanager
def unheard_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes started within this context; it reaches this process afterwards.

    A terminal sends SIGINT to all processes of a command, but only the driver should respond.
    Threads and processes inherit the signal mask, including workers restarted later.
    """
    resource_tracker.ensure_running()  # if started later, it would lift the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
