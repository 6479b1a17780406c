"""How alike two volumes are."""
