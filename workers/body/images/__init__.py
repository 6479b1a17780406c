"""Read images of real organs into volumes."""
