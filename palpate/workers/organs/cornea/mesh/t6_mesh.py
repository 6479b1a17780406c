"""A mesh of 6-node triangles between the two surfaces of a corneal section."""

from dataclasses import dataclass

from palpate.storage.values import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class T6Mesh:
    """Quadratic triangles of a section.

    Parameters
    ----------
    nodes_mm : ndarray, shape (n, 2)
    triangles : ndarray of int32, shape (m, 6)
        Corners 0, 1, 2 counter-clockwise, then the midsides 01, 12 and 20.
    anterior, posterior : ndarray of int32, shape (2 a + 1,) and (2 b + 1,)
        Nodes on the outer and the inner surface from left to right, corners and midsides
        alternating, starting and ending with a corner.
    left, right : ndarray of int32
        Nodes on the two edges of the section (the limbus), from posterior to anterior.
    """

    nodes_mm: FloatArray
    triangles: IntArray
    anterior: IntArray
    posterior: IntArray
    left: IntArray
    right: IntArray
