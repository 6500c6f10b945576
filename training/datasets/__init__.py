"""Data sets; each item is a `Sample`."""
