"""Evaluation of the candidates of a table."""
