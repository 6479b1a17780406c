"""Observation of a deformed body in an image, and its uncertainty.

Points on the tissue interfaces of the reference scan are moved by the model; the
signed distance of each to the interface in a deformed scan is its residual.
No image of the model is rendered, so residuals are smooth in the displacement.
"""
