"""Similarity scores of two volumes."""
