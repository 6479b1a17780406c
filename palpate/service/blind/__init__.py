"""Blind sets: cases with a sealed cause are made, diagnosed and scored."""
