"""Time stamps of two sensors, their matching, and poses: a frame as it was measured."""
