"""Numba options of all kernels.

Kernels are cached on disk, release the GIL and are compiled at their first call.

==================  ===================================================================
`EXACT`             every operation rounds as written: whole numbers, labels, meshes
`EXACT_UNCHECKED`   the same without the branch in every division that raises an exception
                    for a division by zero
`CONTRACTED`        products and sums may be fused into one rounding, zeros lose their
                    sign: elements, distances, products with matrices
==================  ===================================================================

Numba recompiles a kernel when its file changes, but not when this file or a kernel that it
calls from another file changes: then delete the ``__pycache__`` folders.
"""

from typing import Any, Final

EXACT: Final[dict[str, Any]] = {"cache": True, "nogil": True}
EXACT_UNCHECKED: Final[dict[str, Any]] = {**EXACT, "error_model": "numpy"}

# No reassociation: with it LLVM turns the short loops over a row of the tangent into
# gathers, and the product runs five times slower (22 ms against 5 ms at 90k nodes).
CONTRACTED: Final[dict[str, Any]] = {**EXACT_UNCHECKED, "fastmath": {"contract", "nsz"}}
