"""Finite elements: from constants and loads to a displacement."""
