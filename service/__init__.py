"""What decides and tells."""
