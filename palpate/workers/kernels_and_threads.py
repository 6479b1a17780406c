"""Options and array types of all compiled kernels, and the threads that run them for several scans.

Kernels are cached on disk, release the GIL and are compiled at their first call. Numba's options:

==================  ===================================================================
`EXACT`             every operation rounds as written: whole numbers, labels, meshes
`EXACT_UNCHECKED`   the same without the branch in every division that raises an exception
                    for a division by zero
`CONTRACTED`        products and sums may be fused into one rounding, zeros lose their
                    sign: elements, distances, products with matrices
==================  ===================================================================

Numba recompiles a kernel when its file changes, but not when this file or a kernel that it
calls from another file changes: then delete the ``__pycache__`` folders.

`scan_threads` solves the scans of one body in parallel: kernels release the GIL, and scans are
independent of each other. While a diagnosis has fewer tasks than the cluster has threads, this
uses the idle ones; no result depends on it.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

EXACT: Final[dict[str, Any]] = {"cache": True, "nogil": True}
EXACT_UNCHECKED: Final[dict[str, Any]] = {**EXACT, "error_model": "numpy"}

# No reassociation: with it LLVM turns the short loops over a row of the tangent into
# gathers, and the product runs five times slower (22 ms against 5 ms at 90k nodes).
CONTRACTED: Final[dict[str, Any]] = {**EXACT_UNCHECKED, "fastmath": {"contract", "nsz"}}


Float32Array = NDArray[np.float32]
AnyFloatArray = NDArray[np.floating[Any]]
IndexArray = NDArray[np.uint32]
"""Unsigned: compiled loops need not check for negative indices."""


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
