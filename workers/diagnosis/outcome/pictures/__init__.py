"""What a diagnosis shows: bodies, maps and overlaps."""
