"""Images deformed by displacements."""
