"""A breast between two plates: its forward problem and its imaged cases."""
