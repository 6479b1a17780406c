"""Keys of the parts of a study of a breast."""
