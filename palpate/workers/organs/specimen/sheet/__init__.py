"""Thin sheets as bodies of experiments."""
