"""Labelled voxels from a seed."""
