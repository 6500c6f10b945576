"""Where returns land: lens, projection, calibration, poses, and the motion between them."""
