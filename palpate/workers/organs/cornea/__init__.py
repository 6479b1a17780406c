"""A corneal section under an air jet: its image, mesh, equilibrium and score."""
