"""Test cases with known truth, from another solver, with other forms of each effect."""
