"""Inference of the cause of a discrepancy between model and image: arrays in, numbers out."""
