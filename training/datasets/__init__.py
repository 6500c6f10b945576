"""Data sets, whose items are `Sample` objects."""
