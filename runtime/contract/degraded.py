"""The reasons in `Prediction.degraded`: the answer is usable, but less reliable than usual.

Those that make it unusable (`valid` is False) are of `inference.faults`.
"""

NO_DEPTH = "no_depth"  # not one usable return: the answer comes from the camera alone
SPARSE_DEPTH_LOW = "sparse_depth_low"  # returns in too few places, see `preprocess.covers_little`
IMAGE_CONSTANT = "image_constant"  # all pixels are equal: a covered or dead camera
IMPLAUSIBLE_DEPTH = (
    "implausible_depth"  # of a stream, see `runtime.streams.health.depth_plausibility`
)
IMPLAUSIBLE_POSES = "implausible_poses"  # the same of poses: `health.pose_plausibility`
DEPTH_REUSED = "depth_reused"  # the image has no scan of its own, and took an older one
DEPTH_UNCOMPENSATED = "depth_uncompensated"  # returns are not moved to the time of the image
POINTS_UNTIMED = "points_untimed"  # returns were left out: their times are not of their scan
# Why returns were not moved:
NO_POSE = "no_pose"  # no poses for the times of scan and image
POSE_GAP = "pose_gap"  # too much time between two poses
POSE_JUMP = "pose_jump"  # the odometry jumped
POSE_CLOCK = "pose_clock"  # the stamps of the poses are of another clock
#: Those that are of the frame in its stream, not of `Predictor.predict`.
OF_THE_STREAM = {
    *(IMPLAUSIBLE_DEPTH, IMPLAUSIBLE_POSES, DEPTH_REUSED, DEPTH_UNCOMPENSATED, POINTS_UNTIMED),
    *(NO_POSE, POSE_GAP, POSE_JUMP, POSE_CLOCK),
}
