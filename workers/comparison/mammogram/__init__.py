"""Mammograms of labelled voxels by a cone beam of x-rays (thesis section 4.4)."""
