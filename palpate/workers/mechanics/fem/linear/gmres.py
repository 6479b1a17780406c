"""GMRES for a tangent that is not symmetric, preconditioned from the left.

It minimises the preconditioned residual, which estimates the error of the displacement (Saad
and Schultz 1986). The preconditioner rounds to single precision, so the residual is recomputed
in double precision at every restart.
"""

from collections.abc import Callable

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.linear.conjugate_gradients import Correction

# Directions kept, and number of restarts.
DIRECTIONS, RESTARTS = 30, 8
# Reduction of a residual before it is recomputed; beyond it, rounding of the preconditioner
# would dominate.
DEEPEST = 1e-5

Product = Callable[[FloatArray], FloatArray]
"""Linear map of vectors of shape (n, 4), whose last component is zero."""


def solve(multiply: Product, precondition: Product, b: FloatArray, tolerance: float) -> Correction:
    """Solve for `b`, shape (n, 3), to an estimated relative error of the displacement.

    Parameters
    ----------
    multiply, precondition : Product
        The tangent, and an approximation of its inverse.
    b : ndarray, shape (n, 3)
    tolerance : float

    Returns
    -------
    Correction
        `error` is larger than `tolerance` if the iteration ended early; `negative` is False.
    """
    residual = np.zeros((len(b), 4))
    residual[:, :3] = b
    x = np.zeros_like(residual)
    iterations, first, error = 0, 0.0, 0.0
    for restart in range(RESTARTS):
        z = precondition(residual)
        size = float(np.linalg.norm(z))
        first = size if restart == 0 else first
        error = size / first if first > 0 else 0.0
        if error <= tolerance:
            break
        goal = max(tolerance * first, DEEPEST * size)
        step, used, left = _cycle(multiply, precondition, z, goal)
        x += step
        iterations, error = iterations + used, left / first
        if error <= tolerance:
            break
        residual[:, :3] = b
        residual -= multiply(x)
    return Correction(np.ascontiguousarray(x[:, :3]), iterations, error, False)


def _cycle(
    multiply: Product, precondition: Product, z: FloatArray, goal: float
) -> tuple[FloatArray, int, float]:
    """Return a correction for the residual `z`, the number of directions, and the residual left.

    Arnoldi's method with two passes of Gram-Schmidt; the least-squares problem of the Hessenberg
    matrix is small enough to solve afresh each time.
    """
    basis = np.empty((DIRECTIONS + 1, z.size))
    hessenberg = np.zeros((DIRECTIONS + 1, DIRECTIONS))
    size = float(np.linalg.norm(z))
    basis[0] = z.ravel() / size
    target = np.zeros(DIRECTIONS + 1)
    target[0] = size
    for k in range(DIRECTIONS):
        w = precondition(multiply(basis[k].reshape(z.shape))).ravel()
        so_far = basis[: k + 1]
        for _ in range(2):
            along = so_far @ w
            w -= along @ so_far
            hessenberg[: k + 1, k] += along
        length = float(np.linalg.norm(w))
        hessenberg[k + 1, k] = length
        part = hessenberg[: k + 2, : k + 1]
        weights = np.linalg.lstsq(part, target[: k + 2], rcond=None)[0]
        left = float(np.linalg.norm(target[: k + 2] - part @ weights))
        if left <= goal or length <= 1e-14 * size:
            break
        basis[k + 1] = w / length
    return (weights @ so_far).reshape(z.shape), k + 1, left
