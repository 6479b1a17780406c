"""Deviations from the nominal physics, each in a form of its own."""
