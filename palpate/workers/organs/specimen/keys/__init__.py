"""Keys of the parts of a bench experiment."""
