"""Data sets that all give the same `Sample`, their augmentation and their mixture."""
