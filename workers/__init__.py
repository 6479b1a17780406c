"""What turns a candidate into a number."""
