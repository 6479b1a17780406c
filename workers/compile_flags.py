"""Define the options with which all kernels are compiled by numba.

They are kept on disk, release the GIL and are compiled when they are first called.

==================  ===================================================================
`EXACT`             every operation rounds as written: whole numbers, labels, meshes
`EXACT_UNCHECKED`   the same without the branch in every division that raises an exception
                    for a division by zero
`CONTRACTED`        products and sums may be fused into one rounding, zeros lose their
                    sign: elements, distances, products with matrices
==================  ===================================================================

Numba compiles a kernel again when the file of that kernel changes. A change of this file,
or of a kernel that is called from another file, it does not notice: delete the
``__pycache__`` folders then.
"""

from typing import Any, Final

EXACT: Final[dict[str, Any]] = {"cache": True, "nogil": True}
EXACT_UNCHECKED: Final[dict[str, Any]] = {**EXACT, "error_model": "numpy"}

# No reassociation: with it LLVM turns the short loops over a row of the tangent into
# gathers, and the product runs five times slower (22 ms against 5 ms at 90k nodes).
CONTRACTED: Final[dict[str, Any]] = {**EXACT_UNCHECKED, "fastmath": {"contract", "nsz"}}
