"""Keeps on disk what must survive a crash."""
