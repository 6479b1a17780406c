"""Thin sheets as bodies of an experiment."""
