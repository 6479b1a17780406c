"""Chapters of the book, one module each: from results to text, tables and pictures."""
