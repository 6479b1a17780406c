"""Measure what an image says of a deformed body, and how far to trust it.

Points on the tissue interfaces of the reference scan are moved by the model; the
signed distance of each to the interface seen in a deformed scan is its residual.
No image of the model is drawn, so residuals are smooth in the displacement.
"""
