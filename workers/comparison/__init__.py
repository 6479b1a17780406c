"""Comparison of two bodies: deformed volumes, similarity scores, interface distances."""
