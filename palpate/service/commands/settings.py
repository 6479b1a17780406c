"""Values of options that are not given: from the environment, else defaults.

::

    PALPATE_STORE        --store
    PALPATE_SCHEDULER    --scheduler
    PALPATE_WORKERS      --workers

An option overrides the environment; --scheduler and --workers count as one option.
"""

import os
import shlex
from collections.abc import Sequence
from contextvars import ContextVar
from pathlib import Path

from palpate.service.cluster.scheduler_address import host_and_port
from palpate.service.cluster.worker_range import Workers, read_workers
from palpate.storage.backends.places import Place, place_of
from palpate.storage.errors import InputError

STORE, SCHEDULER, WORKERS = "PALPATE_STORE", "PALPATE_SCHEDULER", "PALPATE_WORKERS"
RUNS = Path("runs")

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments of the command", default=())


def remember_command(arguments: Sequence[str]) -> None:
    """Store the command line for `this_command`."""
    _arguments.set(tuple(arguments))


def this_command() -> str:
    """Return the running command in a form that can be pasted into a shell."""
    return shlex.join(["palpate", *_arguments.get()])


def stated_store(option: str | None) -> Place | None:
    """Return the store given as an option or in the environment, or None.

    Raises
    ------
    StoreError
        If it is a URL of an unsupported kind.
    """
    given = option or os.environ.get(STORE)
    return place_of(given) if given else None


def store_place(option: str | None) -> Place:
    """Return the store to use: the one given, else runs/store.

    Raises
    ------
    StoreError
        If it is a URL of an unsupported kind.
    """
    return stated_store(option) or place_of(RUNS / "store")


def cluster_options(
    scheduler: str | None, workers: str | None
) -> tuple[str | None, Workers | None]:
    """Return the scheduler or the number of workers; both None by default.

    Raises
    ------
    InputError
        If both are given, or `workers` is not a number or range, or too small.
    ClusterError
        If the scheduler's address is not valid.
    """
    option = "--workers "
    if scheduler is None and workers is None:
        scheduler = os.environ.get(SCHEDULER) or None
        workers, option = None if scheduler else os.environ.get(WORKERS) or None, f"{WORKERS}="
    elif scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes on this machine; --scheduler uses a running cluster with "
            "its own workers: give one of them."
        )
    if scheduler is not None:
        host_and_port(scheduler)
    return scheduler, None if workers is None else read_workers(workers, option)
