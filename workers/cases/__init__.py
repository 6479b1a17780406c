"""Where the subject of a diagnosis comes from."""
