"""Mechanics of a body: materials, finite elements, effects and their parameters."""
