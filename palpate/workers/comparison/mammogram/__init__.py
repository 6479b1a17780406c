"""Cone-beam mammograms of labelled voxels (thesis section 4.4)."""
