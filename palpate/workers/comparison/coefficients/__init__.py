"""The 28 similarity coefficients compared in thesis section 3.3.2."""
