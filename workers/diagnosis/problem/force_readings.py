"""Readings of forces among the points of an inverse problem.

A load cell is a point whose displacement is the force that it reads, in units that its owner
chooses; what is solved for has one more node for each. It lies far from all others. Its residual
counts in every fit, but it is no distance, so no gap in mm has it.
"""

from scipy.sparse import block_diag, csr_matrix, eye_array

FORCE = 3
"""Number of their interface, beyond those of any organ."""


def at_points_with_forces(own: csr_matrix, readings: int) -> csr_matrix:
    """Return the matrix from nodes to points with so many readings, of that to points alone."""
    return csr_matrix(block_diag([own, eye_array(readings)])) if readings else own
