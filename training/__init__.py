"""Data sets, rendering, losses, metrics and the loop that make checkpoints."""
