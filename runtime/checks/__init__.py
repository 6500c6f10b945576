"""What judges: evidence of frames, readings of a recording, and findings."""
