"""Everything that a run can find wrong with a frame or a sensor, with its meaning."""

from runtime.app.run.frame_record import INVALID, SKIPPED
from runtime.contract import degraded
from runtime.streams.health import frame_health as health

LATE = "late"
CAMERA_SILENT, LIDAR_SILENT = "camera_silent", "lidar_silent"
# The meaning of each reason. --fail-on takes these reasons.
REASONS = {
    SKIPPED: "could not be read or predicted",
    INVALID: "the answer cannot be used",
    LATE: "later than the deadline",
    degraded.NO_DEPTH: "no LiDAR return: camera only",
    degraded.SPARSE_DEPTH_LOW: "LiDAR returns in too few places",
    degraded.DEPTH_REUSED: "returns of an older scan",
    degraded.DEPTH_UNCOMPENSATED: "returns not at the time of the image",
    degraded.POINTS_UNTIMED: "returns with times that are not of their scan were left out",
    degraded.NO_POSE: "no pose at the time of scan or image",
    degraded.POSE_GAP: "too long without a pose",
    degraded.POSE_JUMP: "the odometry jumped",
    degraded.POSE_CLOCK: "poses of another clock",
    degraded.IMPLAUSIBLE_DEPTH: "the returns contradict the image",
    degraded.IMPLAUSIBLE_POSES: "scans moved by the poses contradict each other",
    degraded.IMAGE_CONSTANT: "all pixels are equal",
    health.IMAGE_FROZEN: "same bytes as the image before",
    health.IMAGE_BLACK: "nearly all pixels are dark",
    health.IMAGE_OVEREXPOSED: "half of the pixels are saturated",
    health.LIDAR_MISSING: "no scan or depth map for the image",
    health.LIDAR_EMPTY: "no return of the scan is in the image",
    health.LIDAR_FROZEN: "the same scan again, though the image changed",
    health.LIDAR_SECTOR_LOST: "a sector of the LiDAR is missing",
    health.LIDAR_LINES_LOST: "scan lines of the LiDAR are missing",
    CAMERA_SILENT: "no image for some time",
    LIDAR_SILENT: "no scan or depth map for some time",
}
