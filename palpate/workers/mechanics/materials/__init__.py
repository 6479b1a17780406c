"""Elastic laws of tissue: energies and stresses from deformation gradients."""
