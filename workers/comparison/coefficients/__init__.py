"""The 28 similarity coefficients that thesis section 3.3.2 compares."""
