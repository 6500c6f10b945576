"""What makes a frame of the messages of a recording."""

from dataclasses import dataclass, replace

from runtime.base.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import FIRST_SCAN_NS, assume_middle, lidar_mount
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.streams.frame import Frame
from runtime.streams.messages import Depth, Image, Scan


@dataclass
class Completion:
    """Rectifies images, times scans, and adds calibration and poses.

    Attributes:
        rig: the sensors of the car; what the stamp of a scan marks is used.
        poses: the poses of the car; None: it has none.
        pose_frame: the frame that they are of.
        period_ns: period of the scans.
        rectifies: whether the lens is removed from the images.
    """

    rig: Rig = DEFAULT_RIG
    poses: PoseTrack | None = None
    pose_frame: PoseFrame | str = PoseFrame.BODY
    period_ns: float = FIRST_SCAN_NS
    rectifies: bool = False

    @property
    def to_middle_ns(self) -> int:
        """Time from the stamp of a scan to its middle."""
        return round(self.rig.stamp_to_middle * self.period_ns)

    def complete(
        self,
        image: Image,
        depth: Depth | Scan | None,
        calibration: Calibration | None,
        *,
        reused: bool = False,
        name: str = "",
    ) -> Frame:
        """Return the frame of an image and its depth.

        Raises:
            InputError: if the calibration is for images of another size, which would silently
                falsify clouds and the focal length; and for a depth map of a rectified image.
        """
        poses = None
        if calibration is not None:
            calibration.require_size(image.rgb.shape[:2])
            if self.rectifies:
                if isinstance(depth, Depth):
                    raise InputError(
                        "a depth map lies on the pixels of the distorted image: no `rectify=True`"
                    )
                image = replace(image, rgb=calibration.rectify(image.rgb))
                calibration = calibration.rectified
            if self.poses is not None:
                poses = self.poses.mounted(lidar_mount(self.pose_frame, calibration))
        if isinstance(depth, Scan) and depth.times is None and depth.stamp_ns is not None:
            depth = replace(depth, times=depth.stamp_ns + self.to_middle_ns)
            is_moved = poses is not None and depth.stamp_ns != image.stamp_ns
            if is_moved and self.rig.scan_stamp is None:
                assume_middle()
        return Frame(image, depth, reused, calibration, poses, name)
