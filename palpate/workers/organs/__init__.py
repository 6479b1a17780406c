"""Organs, each with its own models, checks and file keys."""
