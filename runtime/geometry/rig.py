"""The sensors of a car: where they are, what their stamps mean, and which stamps belong together.

One `Rig` describes a car to a live stream, to a replay and to the sources of recordings.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, Literal

from runtime.base.arguments import check_number, shown
from runtime.base.errors import InputError
from runtime.base.stamp import DEFAULT_MAX_SKEW_MS, DEFAULT_REUSE_DEPTH_MS
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import MIDDLE_AFTER, ScanStamp, check_scan_stamp
from runtime.geometry.poses import PoseFrame, check_pose_frame

LONGEST_MEMORY_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A camera and a LiDAR or depth camera on one car.

    Attributes:
        calibration: calibration of camera and LiDAR, or the path of its file, see
            `Calibration.from_file`. Scans cannot be projected without it. Its focal length is used
            if the predictor has none. None: unknown; a source of recordings then looks for the
            recording's own calibration.
        pose_frame: the frame whose poses are given, "lidar", "camera" or "body" (see
            `Calibration.body_from_lidar`); scans are moved to the time of their image. None: no
            poses are given.
        scan_stamp: whether the stamp of a scan marks its "start", "middle" or "end". A scan whose
            points have no times is moved as if all of them were measured in its middle. None:
            "middle", with an `AssumptionWarning` if scans are moved by it.
        max_skew_ms: largest difference between the stamps of an image and its depth.
        reuse_depth_ms: largest age of older depth that is reused for an image without depth of its
            own; 0: depth is never reused. None: 150, except in folders of files without times,
            where depth is never reused.
        memory_s: how many seconds a stream with poses remembers returns, see `ScanMemory`; 0: each
            frame is answered alone. Sources of recordings ignore it.

    Raises:
        InputError: if a value is out of range or has another type.
    """

    calibration: Calibration | Path | str | None = None
    pose_frame: PoseFrame | Literal["lidar", "camera", "body"] | None = None
    scan_stamp: ScanStamp | None = None
    max_skew_ms: float = DEFAULT_MAX_SKEW_MS
    reuse_depth_ms: float | None = None
    memory_s: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if not isinstance(self.calibration, Calibration | Path | str | None):
            raise InputError(
                "calibration must be a Calibration or the path of its file, got "
                f"{shown(self.calibration)}"
            )
        if self.pose_frame is not None:
            check_pose_frame(self.pose_frame)
        if isinstance(self.calibration, str):
            object.__setattr__(self, "calibration", Path(self.calibration))
        if self.scan_stamp is not None:
            check_scan_stamp(self.scan_stamp)
        for name in ("max_skew_ms", "reuse_depth_ms"):
            if (value := getattr(self, name)) is not None or name == "max_skew_ms":
                check_number(name, value, 0, 1e6, "milliseconds", error=InputError)
        most_s = LONGEST_MEMORY_S
        check_number("memory_s", self.memory_s, 0, most_s, "seconds", error=InputError)

    @property
    def max_depth_age_ms(self) -> float:
        """`reuse_depth_ms`, or the default for streams."""
        return DEFAULT_REUSE_DEPTH_MS if self.reuse_depth_ms is None else self.reuse_depth_ms

    @property
    def stamp_to_middle(self) -> float:
        """Time from the stamp of a scan to its middle, in scan durations."""
        return MIDDLE_AFTER[self.scan_stamp or "middle"]

    def read_calibration(self, **of_file: Any) -> Calibration | None:
        """Return the calibration; `of_file` are the options with which a file is read."""
        if isinstance(self.calibration, Path | str):
            return Calibration.from_file(self.calibration, **of_file)
        return self.calibration

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the attributes of the sensors that differ from their defaults."""
        of_sensors = (each for each in fields(self) if each.name != "memory_s")
        return tuple(each.name for each in of_sensors if getattr(self, each.name) != each.default)


# The rig of a car about which nothing is known.
DEFAULT_RIG: Final = Rig()
