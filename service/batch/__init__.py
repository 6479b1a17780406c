"""Candidates of a table, evaluated as those of a search are."""
