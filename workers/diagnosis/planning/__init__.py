"""What scans can tell before they are made."""
