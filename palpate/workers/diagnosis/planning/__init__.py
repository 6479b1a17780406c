"""Planning of scans, based on their expected information."""
