"""Writes self-contained pages about studies, diagnoses and plans."""
