"""Everything that a run can find wrong with a frame or a sensor, with its meaning."""

from runtime.app.run.frame_record import INVALID, SKIPPED
from runtime.checks.frame_health import SENSOR_FAULTS
from runtime.contract.degraded import DEGRADED

LATE, CALIBRATION = "late", "calibration"
CAMERA_SILENT, LIDAR_SILENT = "camera_silent", "lidar_silent"
# The meaning of each reason. --fail-on takes these reasons.
REASONS = {
    SKIPPED: "could not be read or predicted",
    INVALID: "the answer cannot be used",
    LATE: "later than the deadline",
    CALIBRATION: "the returns fit the images better another way",
    **DEGRADED,
    **SENSOR_FAULTS,
    CAMERA_SILENT: "no image for some time",
    LIDAR_SILENT: "no scan or depth map for some time",
}
