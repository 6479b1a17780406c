"""One simulation at a time, as arrays."""
