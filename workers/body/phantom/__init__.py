"""Draw labelled voxels from a seed."""
