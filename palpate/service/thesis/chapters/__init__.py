"""Chapters of the thesis page, one module each: from results to text, tables and pictures."""
