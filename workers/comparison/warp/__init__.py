"""Deformed images from displacements."""
