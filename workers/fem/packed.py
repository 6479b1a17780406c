"""A tangent made ready for many products: packed rows, block Jacobi, the plate.

Each method takes vectors of one right-hand side, (n, 4), or of `LANES`, (n, 4,
LANES), in single or double precision.
"""

from types import ModuleType

import numpy as np

from workers.fem import operators, rows, rows_many
from workers.fem.kernels import Float32Array
from workers.fem.level import Level, Tangent
from workers.fem.rows import AnyFloat


class Packed:
    """The tangent of a level; the travel of its plate is eliminated by a rank-one term."""

    def __init__(self, level: Level, tangent: Tangent) -> None:
        g, n = level.model.graph, len(level.model.nodes)
        t = tangent
        self._matrix = g.start.view(np.uint32), g.neighbour.view(np.uint32), t.rows
        self._inverse = np.empty((n, 9), np.float32)
        operators.invert_diagonal(g.start, g.diagonal, t.rows, level.free, self._inverse)
        self._pads = t.pads.astype(np.uint32)
        self._coupling = np.ascontiguousarray(t.coupling) * level.free[t.pads]
        self._factor = 1 / t.plate_stiffness if t.plate_stiffness > 0 else 0.0
        self._free = np.zeros((n, 4), np.float32)
        self._free[:, :3] = level.free

    def only_free(self, x: Float32Array, y: Float32Array) -> None:
        """y = `x` without held displacements and without its pressure."""
        np.multiply(x, self._free if x.ndim == 2 else self._free[:, :, None], out=y)

    def apply(self, x: AnyFloat, y: AnyFloat) -> None:
        """y = tangent times x; sets the pressure of `x`."""
        kernels = _kernels(x)
        kernels.pressurise(*self._matrix, x)
        kernels.multiply(*self._matrix, x, y)
        self._plate(kernels, -self._factor, x, y)

    def relax(self, x: Float32Array, z: Float32Array) -> None:
        """z = block Jacobi of x."""
        operators.apply_diagonal(self._inverse, x, z)

    def pressurise(self, x: AnyFloat) -> None:
        """Set the pressure of `x`, whose held displacements are zero."""
        _kernels(x).pressurise(*self._matrix, x)

    def subtract(self, x: Float32Array, r: Float32Array) -> None:
        """r -= tangent times x; `x` knows its pressure."""
        kernels = _kernels(x)
        self._plate(kernels, self._factor, x, r)
        kernels.subtract(*self._matrix, x, r)

    def first_step(self, scale: np.float32, r: Float32Array, step: Float32Array) -> None:
        """step = block Jacobi of `r`, scaled, with its pressure."""
        _kernels(r).first_step(*self._matrix, self._inverse, scale, r, step)

    def sweep(
        self,
        keep: np.float32,
        scale: np.float32,
        r: Float32Array,
        x: Float32Array,
        old: Float32Array,
        new: Float32Array,
        spread: bool = True,
    ) -> None:
        """Take the step `old` and add the next one, `new`, to `x`; see `rows.sweep`."""
        kernels = _kernels(x)
        self._plate(kernels, self._factor, old, r)
        kernels.sweep(*self._matrix, self._inverse, keep, scale, r, x, old, new, spread)

    def _plate(self, kernels: ModuleType, factor: float, x: AnyFloat, y: AnyFloat) -> None:
        if factor:
            kernels.add_rank_one(self._pads, self._coupling, factor, x, y)


def _kernels(x: AnyFloat) -> ModuleType:
    return rows if x.ndim == 2 else rows_many
