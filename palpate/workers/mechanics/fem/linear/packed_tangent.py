"""Tangent prepared for many products: packed rows, block Jacobi, the plates' travel.

Each method takes vectors of one right-hand side, (n, 4), or of `LANES`, (n, 4,
LANES), in single or double precision.
"""

import numpy as np

from palpate.workers.mechanics.fem.linear import block_jacobi, sparse_products
from palpate.workers.mechanics.fem.linear.level import Level, Tangent
from palpate.workers.mechanics.fem.problem.array_types import AnyFloatArray, Float32Array


class PackedTangent:
    """Tangent of a level; the travel of its plates is eliminated by a rank-one term."""

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g, n = level.model.graph, len(level.model.nodes)
        t = tangent
        self._matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), t.rows
        self._inverse = np.empty((n, 9), np.float32)
        block_jacobi.invert_diagonal(g.start, g.diagonal, t.rows, level.free, self._inverse)
        self._index = t.contact_index.astype(np.uint32)
        self._coupling = np.ascontiguousarray(t.coupling) * level.free[t.contact_index]
        self._factor = 1 / t.plate_stiffness if t.plate_stiffness > 0 else 0.0
        self._free = np.zeros((n, 4), np.float32)
        self._free[:, :3] = level.free

    def only_free(self, x: Float32Array, y: Float32Array) -> None:
        """Set y to `x`, with held displacements and the pressures set to zero."""
        np.multiply(x, self._free if x.ndim == 2 else self._free[:, :, None], out=y)

    def multiply(self, x: AnyFloatArray, y: AnyFloatArray) -> None:
        """Set y to the tangent times x, and set the pressure of `x`."""
        sparse_products.set_pressure(*self._matrix, x)
        sparse_products.multiply(*self._matrix, x, y)
        self._add_travel(-self._factor, x, y)

    def apply_block_jacobi(self, x: Float32Array, z: Float32Array) -> None:
        """Set z to the block Jacobi product of x, both (n, 4)."""
        block_jacobi.apply_diagonal(self._inverse, x, z)

    def set_pressure(self, x: AnyFloatArray) -> None:
        """Set the pressure of `x`, whose held displacements are zero."""
        sparse_products.set_pressure(*self._matrix, x)

    def subtract_product(self, x: Float32Array, r: Float32Array) -> None:
        """Subtract tangent times x from `r`; the pressure of `x` is set."""
        self._add_travel(self._factor, x, r)
        sparse_products.subtract_product(*self._matrix, x, r)

    def first_step(self, scale: np.float32, r: Float32Array, step: Float32Array) -> None:
        """Set the step to the scaled block Jacobi product of `r`, with its pressure."""
        sparse_products.first_step(*self._matrix, self._inverse, scale, r, step)

    def smoothing_sweep(
        self,
        momentum: np.float32,
        scale: np.float32,
        r: Float32Array,
        x: Float32Array,
        old: Float32Array,
        new: Float32Array,
        with_pressure: bool = True,
    ) -> None:
        """Take the step `old` and add the next one, `new`, to `x`; see `sparse_products`."""
        self._add_travel(self._factor, old, r)
        sparse_products.smoothing_sweep(
            *self._matrix, self._inverse, momentum, scale, r, x, old, new, with_pressure
        )

    def _add_travel(self, factor: float, x: AnyFloatArray, y: AnyFloatArray) -> None:
        """Add the rank-one term of the eliminated travel to `y`."""
        if factor:
            sparse_products.add_rank_one(self._index, self._coupling, factor, x, y)
