"""What this package adds to ssdnet."""
