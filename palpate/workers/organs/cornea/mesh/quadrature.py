"""Quadrature points and weights on a triangle, by number of points."""

import numpy as np

from palpate.storage.values import FloatArray

# Degree 2 and degree 5; O. C. Zienkiewicz and R. L. Taylor, The Finite Element Method.
_A, _B = 0.470142064105115, 0.101286507323456
_W = (0.1125, 0.066197076394253, 0.0629695902724135)
QUADRATURE: dict[int, tuple[FloatArray, FloatArray]] = {
    3: (np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]]), np.full(3, 1 / 6)),
    7: (
        np.array(
            [
                [1 / 3, 1 / 3],
                [_A, _A],
                [1 - 2 * _A, _A],
                [_A, 1 - 2 * _A],
                [_B, _B],
                [1 - 2 * _B, _B],
                [_B, 1 - 2 * _B],
            ]
        ),
        np.array([_W[0], *[_W[1]] * 3, *[_W[2]] * 3]),
    ),
}
