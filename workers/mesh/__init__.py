"""Tetrahedra from voxels."""
