"""Pictures of a diagnosis: bodies, maps and overlaps."""
