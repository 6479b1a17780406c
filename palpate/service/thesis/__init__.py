"""Reproduction of the thesis: its experiments, compared with its printed results, on one page."""
