"""Deviations from the nominal physics, each in its own mathematical form."""
