"""Force readings among the points of an inverse problem.

A load cell is represented by a point whose displacement is the measured force, in units chosen by
the organ, with one additional node far from all others. Its residual counts in every fit, but not
in any gap in mm, because it is not a distance.
"""

from scipy.sparse import block_diag, csr_matrix, eye_array

FORCE = 3
"""Interface number of force readings, beyond those of any organ."""


def at_points_with_forces(own: csr_matrix, readings: int) -> csr_matrix:
    """Extend the interpolation matrix of points by rows for a number of force readings."""
    return csr_matrix(block_diag([own, eye_array(readings)])) if readings else own
