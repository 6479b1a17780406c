"""Test cases with known truth: another solver, other forms of every effect, sealed noise."""
