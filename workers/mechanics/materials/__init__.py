"""Compute elastic laws of tissue: deformation gradients in, energies and stresses out."""
