"""Comparison of two bodies: deformed volumes, similarity scores and interface distances."""
