"""Rigid registration of the camera frame to the body frame.

The rotation comes from the rigid motion that best fits the markers at rest (W. Kabsch, Acta
Cryst. A 32 (1976) 922; B. K. P. Horn, J. Opt. Soc. Am. A 4 (1987) 629).
"""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray


def rotation_to(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Return the rotation R from the camera frame to the body frame, shape (3, 3).

    Parameters
    ----------
    body_mm, seen_mm : ndarray, shape (k, 3)
        Positions of the same markers at rest, in the body frame and in the camera frame.

    Raises
    ------
    InputError
        If there are fewer than three markers, or all are on one line.
    """
    a, b = body_mm - body_mm.mean(axis=0), seen_mm - seen_mm.mean(axis=0)
    spread = np.linalg.svd(a, compute_uv=False)
    if len(a) < 3 or spread[1] < 1e-3 * spread[0]:
        raise InputError(
            f"Registration needs at least three markers that are not on one line, found {len(a)}."
        )
    U, _, Vt = np.linalg.svd(a.T @ b)
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U @ turn @ Vt)


def misfit_mm(body_mm: FloatArray, seen_mm: FloatArray) -> FloatArray:
    """Return the residual of each marker after the best rigid motion, shape (k,)."""
    R = rotation_to(body_mm, seen_mm)
    left = (seen_mm - seen_mm.mean(axis=0)) @ R.T - (body_mm - body_mm.mean(axis=0))
    return np.asarray(np.linalg.norm(left, axis=1))
