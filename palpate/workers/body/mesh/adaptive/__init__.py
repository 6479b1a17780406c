"""Graded tetrahedra whose faces follow the surface between two tissues (thesis section 4.4)."""
