"""Measure how alike two bodies are: deformed volumes, similarity scores, interface distances."""
