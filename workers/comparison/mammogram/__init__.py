"""Mammograms of labelled voxels: a cone of x-rays, tissue by tissue (thesis section 4.4)."""
