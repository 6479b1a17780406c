"""Score how alike two volumes are."""
