"""A breast between two plates: its problem for the solver, and imaged cases of it."""
