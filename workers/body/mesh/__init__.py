"""Make tetrahedra from voxels."""
