"""Labelled voxels generated from a seed."""
