"""Planning of scans: their expected information."""
