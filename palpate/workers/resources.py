"""Resources of a worker process: one thread for each evaluation, and a bounded cache.

This is the only module of the package that uses Dask. It also works in processes that are not
Dask workers.
"""

import logging
import os
import socket
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from dataclasses import fields, is_dataclass
from functools import partial
from types import CellType, FunctionType, MethodType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np
from distributed import Worker, WorkerPlugin, get_worker

from palpate.workers import WORKER_ENVIRONMENT

T = TypeVar("T")

_log = logging.getLogger(__name__)

CACHE_BYTES = 2 * 1024**3


class OneThread(WorkerPlugin):
    """A worker plug-in that limits libraries to one thread.

    Register it with ``client.register_plugin(OneThread())``. It takes effect for numba, but
    too late for the BLAS of NumPy, which Dask itself loads: a worker started without
    `WORKER_ENVIRONMENT` logs a warning.
    """

    name = "palpate-one-thread"
    idempotent = True

    def setup(self, worker: Worker) -> None:
        """Set the variables; Dask calls this on every worker, including later ones."""
        if os.environ.get("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS")) != "1":
            _log.warning(
                "The worker %s was started without OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1: "
                "parallel evaluations may slow each other down. Set them in the environment that "
                "starts it.",
                worker.name,
            )
        os.environ.update(WORKER_ENVIRONMENT)


def worker_name() -> str:
    """Return the name of the current Dask worker, or else the host name and process id."""
    try:
        return str(get_worker().name)
    except ValueError:
        return f"{socket.gethostname()}-{os.getpid()}"


class Cache:
    """A cache of the most recently used values.

    Parameters
    ----------
    capacity_bytes : int
        Limit on the total size of all arrays; above it, the least recently used values are evicted.
        The newest value is kept, whatever its size.

    Notes
    -----
    Thread-safe: each value is computed only once.
    """

    def __init__(self, capacity_bytes: int = CACHE_BYTES) -> None:
        self.capacity_bytes = capacity_bytes
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of `key`, computed by `make` unless it is cached."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return cast(T, self._values[key])
            making = self._making.setdefault(key, threading.Lock())
        with making:
            with self._lock:
                if key in self._values:
                    return cast(T, self._values[key])
            value = make()
            with self._lock:
                self._values[key] = value
                self._making.pop(key, None)
                self._evict()
        return value

    def clear(self) -> None:
        """Remove all values."""
        with self._lock:
            self._values.clear()

    @property
    def used_bytes(self) -> int:
        """Return the current size of the arrays of all values, which may grow after creation."""
        return size_bytes(list(self._values.values()))

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: object) -> bool:
        return key in self._values

    def _evict(self) -> None:
        while len(self._values) > 1 and self.used_bytes > self.capacity_bytes:
            self._values.popitem(last=False)


CACHE = Cache()
"""Cache of this process."""


def size_bytes(value: object) -> int:
    """Return the total bytes of all arrays in a dataclass, container, function or object.

    An array that occurs twice is counted once.
    """
    counted: set[int] = set()
    total = 0
    pending: list[object] = [value]
    while pending:
        item = pending.pop()
        if id(item) in counted:
            continue
        counted.add(id(item))
        if isinstance(item, np.ndarray):
            total += item.nbytes
        else:
            pending.extend(_parts(item))
    return total


def _parts(item: object) -> Iterable[object]:
    if isinstance(item, dict):
        return item.values()
    if isinstance(item, list | tuple | set | frozenset):
        return item
    if isinstance(item, type | ModuleType):
        return ()
    if isinstance(item, partial):
        return (item.func, item.args, item.keywords)
    if isinstance(item, FunctionType):
        cells = item.__closure__ or ()
        return [cell.cell_contents for cell in cells if cell != CellType()]
    if isinstance(item, MethodType):
        return (item.__self__,)
    # Lazily computed values are not fields.
    parts = list(vars(item).values()) if hasattr(item, "__dict__") else []
    if is_dataclass(item):
        parts += [getattr(item, field.name) for field in fields(item)]
    return parts
