"""From a displacement back to an image."""
