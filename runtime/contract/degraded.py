"""The reasons in `Prediction.degraded` for a usable answer that is less reliable than usual.

`inference.output_faults` has the reasons that make an answer unusable (`valid` is False).
"""

# Each reason with its meaning.
DEGRADED: dict[str, str] = {
    (NO_DEPTH := "no_depth"): "no LiDAR return: camera only",
    (SPARSE_DEPTH_LOW := "sparse_depth_low"): "LiDAR returns in too few places",
    (DEPTH_REUSED := "depth_reused"): "returns of an older scan",
    (DEPTH_UNCOMPENSATED := "depth_uncompensated"): "returns not at the time of the image",
    (POINTS_UNTIMED := "points_untimed"): (
        "returns with times that are not of their scan were left out"
    ),
    # Why returns were not moved:
    (NO_POSE := "no_pose"): "no pose at the time of scan or image",
    (POSE_GAP := "pose_gap"): "too long without a pose",
    (POSE_JUMP := "pose_jump"): "the odometry jumped",
    (POSE_CLOCK := "pose_clock"): "poses of another clock",
    # What later frames show, see `runtime.checks`:
    (IMPLAUSIBLE_DEPTH := "implausible_depth"): "the returns contradict the image",
    (IMPLAUSIBLE_POSES := "implausible_poses"): "scans moved by the poses contradict each other",
    # What a faulty camera, dirt, water or the night make of an image, see `image_quality`:
    (IMAGE_CONSTANT := "image_constant"): "all pixels are equal",
    (IMAGE_BLURRED := "image_blurred"): "no edge is sharp",
    (IMAGE_DARK := "image_dark"): "hardly any pixel is bright",
    (IMAGE_OVEREXPOSED := "image_overexposed"): "half of the pixels are saturated",
}

# Those for which an image shows little, so that nothing is judged by the answer to it alone.
IMAGE_DOUBTS = IMAGE_BLURRED, IMAGE_DARK, IMAGE_OVEREXPOSED
