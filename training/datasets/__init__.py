"""Data sets that all give the same `Sample`."""
