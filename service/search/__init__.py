"""Searches: pure functions from what was told to what to try next."""
