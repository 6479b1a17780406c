"""Tetrahedral meshes from voxels."""
