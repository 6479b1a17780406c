"""Observation of a deformed body in an image, and its uncertainty.

Points on the tissue interfaces of the reference scan are moved by the model; the residual of each
is its signed distance to the interface in a deformed scan. The model is not rendered as an image,
so residuals are smooth in the displacement.
"""
