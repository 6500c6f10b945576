"""A ROS 2 node: classes and depth of one camera and one LiDAR. Copy it; the engine needs no ROS.

    python examples/ros2_node.py [--ros-args --params-file qos.yaml -p memory_s:=2.0]

`PushStream` predicts in a thread of its own, so the callbacks never wait for inference. It
publishes, with the stamp and the frame id of the image:

- `~/depth` (metres), `~/semantic` (class ids): sensor_msgs/Image.
- `~/points`: sensor_msgs/PointCloud2 with x, y, z, rgb, class and uncertainty, a point in each cube
  of VOXEL_M; `~/camera_info`: sensor_msgs/CameraInfo. Both as `ssdnet-run --mcap` writes them.
- `/diagnostics`: the health of each answer, and the state of the stream also while none comes.

The poses come from `odometry`, or, if the parameter fixed_frame is given (odom), from the transform
of /tf between it and body_frame (base_link). memory_s is how many seconds of earlier returns are
fed, too (0: none).

`image` and `points` are best effort, the last 5; `odometry` and `/tf` are best effort, the last 200
(a second at 200 Hz); what is published is reliable, the last 5. Parameters override the quality of
service, by the topic's full name:

    /ssdnet:
      ros__parameters:
        memory_s: 2.0
        fixed_frame: odom
        qos_overrides:
          /odometry:
            subscription: {reliability: reliable, depth: 400}
"""

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from sensor_msgs_py import point_cloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from runtime import (
    Calibration,
    FrameResult,
    Predictor,
    PushStream,
    Rig,
    SSDNetError,
    camera_fields,
    cloud_fields,
    odometry_pose,
    point_times_s,
    status_fields,
)

# Your calibration: fx 0 cx / 0 fy cy / 0 0 1, and LiDAR to camera. Of raw images also
# Calibration(lens=, distortion=).
INTRINSICS = np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])
EXTRINSICS = np.array([[0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1.0]])
# LiDAR to the frame whose poses are subscribed to, its child_frame_id (base_link).
BODY_FROM_LIDAR = np.array([[1.0, 0, 0, 0.8], [0, 1, 0, 0], [0, 0, 1, 1.4], [0, 0, 0, 1]])
CALIBRATION = Calibration(INTRINSICS, EXTRINSICS, body_from_lidar=BODY_FROM_LIDAR)
VOXEL_M = 0.1


def nanoseconds(message: Any) -> int:
    """Return the sensor's stamp as an integer, without rounding."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def best_effort(queue: int) -> QoSProfile:
    """Return a new profile, into which ROS writes the overrides of one topic."""
    return QoSProfile(depth=queue, reliability=ReliabilityPolicy.BEST_EFFORT)


class SSDNetNode(Node):
    def __init__(self) -> None:
        super().__init__("ssdnet")
        self.bridge = CvBridge()
        self.frame_id = ""  # of the images
        settable = {"qos_overriding_options": QoSOverridingOptions.with_default_policies()}
        self.outputs = {
            topic: self.create_publisher(kind, topic, QoSProfile(depth=5), **settable)
            for topic, kind in (
                ("~/depth", Image),
                ("~/semantic", Image),
                ("~/points", PointCloud2),
                ("~/camera_info", CameraInfo),
                ("/diagnostics", DiagnosticArray),
            )
        }

        def parameter(name: str, default: Any) -> Any:
            return self.declare_parameter(name, default).value

        self.moves = parameter("fixed_frame", ""), parameter("body_frame", "base_link")
        self.predictor = Predictor()  # the focal length is the calibration's
        self.stream = PushStream(
            self.predictor,
            # Without poses leave pose_frame out.
            Rig(calibration=CALIBRATION, pose_frame="body", memory_s=parameter("memory_s", 0.0)),
            deadline_ms=80,
            on_result=self.publish,
            on_error=lambda error: self.get_logger().error(str(error)),
            on_state=lambda state: self.report(self.header(self.get_clock().now().to_msg())),
        )
        poses = (TFMessage, "/tf", self.on_transforms, 200)
        for kind, topic, callback, queue in (
            (Image, "image", self.on_image, 5),
            (PointCloud2, "points", self.on_points, 5),
            poses if self.moves[0] else (Odometry, "odometry", self.on_odometry, 200),
        ):
            self.create_subscription(kind, topic, callback, best_effort(queue), **settable)

    def on_image(self, message: Image) -> None:
        self.frame_id = message.header.frame_id
        self.push(self.stream.push_image, self.bridge.imgmsg_to_cv2(message, "rgb8"), message)

    def on_points(self, message: PointCloud2) -> None:
        fields = ("x", "y", "z")
        points = point_cloud2.read_points_numpy(message, fields, skip_nans=False)
        points = np.ascontiguousarray(points, np.float32)
        times = point_times_s(message, nanoseconds(message), points)  # None without such a field
        self.push(self.stream.push_points, points, message, times)

    def on_transforms(self, message: TFMessage) -> None:
        for stamped in message.transforms:
            if (stamped.header.frame_id, stamped.child_frame_id) == self.moves:
                self.on_odometry(stamped)

    def on_odometry(self, message: Any) -> None:
        try:
            pose = odometry_pose(message)
        except SSDNetError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
        else:
            self.push(self.stream.push_pose, pose, message)

    def push(
        self, push: Callable[..., None], array: NDArray[Any], message: Any, *others: Any
    ) -> None:
        try:
            push(array, nanoseconds(message), *others)
        except SSDNetError as error:  # the text says what was expected
            self.get_logger().error(str(error), throttle_duration_sec=1.0)

    def publish(self, result: FrameResult) -> None:
        """Called in the stream's thread with each answer."""
        prediction = result.prediction
        header = self.header(self.get_clock().now().to_msg())
        header.stamp.sec, header.stamp.nanosec = divmod(result.image_stamp, 10**9)
        self.report(header, result)
        if not prediction.valid:
            return
        for topic, values, encoding in (
            ("~/depth", prediction.depth, "32FC1"),  # metres
            ("~/semantic", prediction.semantic, "mono8"),  # ids of predictor.contract.classes
        ):
            image = self.bridge.cv2_to_imgmsg(values, encoding)
            image.header = header
            self.outputs[topic].publish(image)
        cloud = cloud_fields(prediction.points(CALIBRATION, result.rgb, voxel_m=VOXEL_M))
        cloud["fields"] = [PointField(**field) for field in cloud["fields"]]
        cloud["data"] = array("B", cloud["data"].tobytes())  # taken without a check of each byte
        self.outputs["~/points"].publish(PointCloud2(header=header, **cloud))
        camera = camera_fields(CALIBRATION, prediction.frame_size)
        camera["d"] = camera["d"].tolist()
        self.outputs["~/camera_info"].publish(CameraInfo(header=header, **camera))

    def header(self, stamp: Any) -> Header:
        return Header(stamp=stamp, frame_id=self.frame_id)

    def report(self, header: Header, result: FrameResult | None = None) -> None:
        """Publish the health of an answer and the state of the stream."""
        fields = status_fields(result, self.stream.state)
        status = DiagnosticStatus(
            level=bytes([fields["level"]]),  # a byte of ROS is bytes in Python
            message=fields["message"],
            name="ssdnet",
            hardware_id=self.predictor.contract.model_name,
            values=[KeyValue(key=key, value=value) for key, value in fields["values"].items()],
        )
        self.outputs["/diagnostics"].publish(DiagnosticArray(header=header, status=[status]))

    def destroy_node(self) -> None:
        self.stream.close()  # answers what was accepted, then ends
        self.predictor.close()
        super().destroy_node()


def main() -> None:
    rclpy.init()
    node = SSDNetNode()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
