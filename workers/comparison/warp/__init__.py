"""Turn a displacement into a deformed image."""
