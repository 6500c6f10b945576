"""The reasons in `Prediction.degraded` for a usable answer that is less reliable than usual.

`inference.output_faults` has the reasons that make an answer unusable (`valid` is False).
"""

NO_DEPTH = "no_depth"  # no usable return: the answer comes from the camera alone
SPARSE_DEPTH_LOW = "sparse_depth_low"  # returns in too few places, see `preprocess.covers_little`
IMAGE_CONSTANT = "image_constant"  # all pixels are equal: a covered or dead camera
IMPLAUSIBLE_DEPTH = (
    "implausible_depth"  # in a stream, see `runtime.streams.health.depth_plausibility`
)
IMPLAUSIBLE_POSES = "implausible_poses"  # in a stream, see `health.pose_plausibility`
DEPTH_REUSED = "depth_reused"  # the image has no scan of its own, and uses an older one
DEPTH_UNCOMPENSATED = "depth_uncompensated"  # returns are not moved to the time of the image
POINTS_UNTIMED = "points_untimed"  # returns were left out: their times are outside their scan
# Why returns were not moved:
NO_POSE = "no_pose"  # no poses at the times of scan and image
POSE_GAP = "pose_gap"  # the time between two poses is too long
POSE_JUMP = "pose_jump"  # the odometry jumped
POSE_CLOCK = "pose_clock"  # the stamps of the poses come from another clock
# The reasons that a stream or a run adds, not `Predictor.predict`.
STREAM_REASONS = {
    *(IMPLAUSIBLE_DEPTH, IMPLAUSIBLE_POSES, DEPTH_REUSED, DEPTH_UNCOMPENSATED, POINTS_UNTIMED),
    *(NO_POSE, POSE_GAP, POSE_JUMP, POSE_CLOCK),
}
