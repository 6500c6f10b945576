"""Whether the rotation between camera and LiDAR is right, found without a target."""
