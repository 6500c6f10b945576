"""Messages of two sensors, their matching, and the frame as it was measured."""
