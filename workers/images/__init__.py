"""Images of real organs, read into volumes."""
