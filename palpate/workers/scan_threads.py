"""Threads that solve the scans of one body in parallel.

Kernels release the GIL, and scans are independent of each other. While a diagnosis has fewer
tasks than the cluster has threads, this uses the idle ones; no result depends on it.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeAlias

Each: TypeAlias = Callable[..., Iterable[Any]]
"""Function that calls another with the items of sequences of equal length, like `map`."""


@contextmanager
def scan_threads(threads: int) -> Iterator[Each]:
    """Provide a `map` over scans that uses at most `threads` threads.

    Parameters
    ----------
    threads : int
        Number of threads, limited to the number of cores.
    """
    threads = min(threads, os.cpu_count() or 1)
    if threads < 2:
        yield map
        return
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map
