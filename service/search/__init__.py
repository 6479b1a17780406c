"""Searches by pure functions from the generations so far to the candidates to try next."""
