"""Finite elements: displacements from constants and loads."""
