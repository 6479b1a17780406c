"""Reproduction of the thesis: its experiments, compared with its printed results, as a book."""
