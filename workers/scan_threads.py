"""Threads that solve the scans of one body side by side.

Kernels release the lock of the interpreter, and a scan needs nothing of another one. While a
diagnosis has fewer tasks than the cluster has threads, this keeps the others busy; no result
depends on it.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeAlias

Each: TypeAlias = Callable[..., Iterable[Any]]
"""Calls a function with the items of some sequences of one length, as `map` does."""


@contextmanager
def scan_threads(threads: int) -> Iterator[Each]:
    """Give what calls a function with every scan, at most so many at a time.

    Parameters
    ----------
    threads : int
        More than this machine has cores do not help, and are not taken.
    """
    threads = min(threads, os.cpu_count() or 1)
    if threads < 2:
        yield map
        return
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map
