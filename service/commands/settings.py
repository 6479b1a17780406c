"""What holds where an option is not given: the environment, then a default.

::

    PALPATE_STORE        --store
    PALPATE_SCHEDULER    --scheduler
    PALPATE_WORKERS      --workers

An option counts more than the environment, for --scheduler and --workers together.
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
    """Note what was typed, for `this_command`."""
    _arguments.set(tuple(arguments))


def this_command() -> str:
    """Return the command that is running, as it can be typed again."""
    return shlex.join(["palpate", *_arguments.get()])


def stated_store(option: str | None) -> Place | None:
    """Return the store that was given as an option or in the environment, or None.

    Raises
    ------
    StoreError
        If it is a URL of a place where no store can be.
    """
    given = option or os.environ.get(STORE)
    return place_of(given) if given else None


def store_place(option: str | None) -> Place:
    """Return the store that is used: what was given, else runs/store.

    Raises
    ------
    StoreError
        If it is a URL of a place where no store can be.
    """
    return stated_store(option) or place_of(RUNS / "store")


def cluster_options(
    scheduler: str | None, workers: str | None
) -> tuple[str | None, Workers | None]:
    """Return the scheduler or the number of workers that is used; neither by default.

    Raises
    ------
    InputError
        If both are given, or `workers` is no number or range, or too few.
    ClusterError
        If the scheduler's address is none.
    """
    option = "--workers "
    if scheduler is None and workers is None:
        scheduler = os.environ.get(SCHEDULER) or None
        workers, option = None if scheduler else os.environ.get(WORKERS) or None, f"{WORKERS}="
    elif scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes of this machine, --scheduler uses those of a running "
            "cluster, whose number is not ours to change: give one of them."
        )
    if scheduler is not None:
        host_and_port(scheduler)
    return scheduler, None if workers is None else read_workers(workers, option)
