"""Time stamps, the matching of two sensors by them, and latency statistics."""
