"""Inference of the cause of a model-image discrepancy: arrays in, numbers out."""
