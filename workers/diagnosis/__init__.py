"""What the difference between model and image says about its cause: arrays in, numbers out."""
