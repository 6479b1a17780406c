"""Single simulations as arrays."""
