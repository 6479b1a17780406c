"""Thin sheets in plane stress: 6-node triangles, any law, in their plane or inflated."""
