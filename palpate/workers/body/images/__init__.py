"""Images of real organs as volumes."""
