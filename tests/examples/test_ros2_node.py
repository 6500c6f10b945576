"""The node of examples/ros2_node.py runs, with stand-ins for the modules of ROS."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from runtime.geometry.assumptions import AssumptionWarning
from runtime.recordings.bundled_stream import bundled_frames

NODE = Path(__file__).parents[2] / "examples" / "ros2_node.py"
SECONDS, NANOSECONDS = 1_700_000_000, 123_456_789


def stamped(*, frame_id="", **fields):
    stamp = SimpleNamespace(sec=SECONDS, nanosec=NANOSECONDS)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=frame_id), **fields)


class Made(SimpleNamespace):
    """A message that is made of its fields."""


class Node:
    """The part of rclpy's node that the example uses."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        self.name, self.sent, self.callbacks, self.logged = name, {}, {}, []
        self.statuses = []

    def declare_parameter(self, name, default):
        return SimpleNamespace(value=self.parameters.get(name, default))

    def create_publisher(self, kind, topic, qos, *, qos_overriding_options):
        assert qos_overriding_options == "with default policies"

        def publish(message):
            self.sent[topic] = message
            self.statuses += getattr(message, "status", [])

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, qos, *, qos_overriding_options):
        assert qos_overriding_options == "with default policies"
        self.callbacks[topic] = callback

    def get_clock(self):
        stamp = SimpleNamespace(sec=1, nanosec=2)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp))

    def get_logger(self):
        def log(text, throttle_duration_sec=None):
            self.logged.append(text)

        return SimpleNamespace(error=log, info=log, warn=log)

    def destroy_node(self):
        self.destroyed = True


class CvBridge:
    def imgmsg_to_cv2(self, message, encoding):
        assert encoding == "rgb8"
        return message.image

    def cv2_to_imgmsg(self, values, encoding):
        return stamped(values=values, encoding=encoding)


@pytest.fixture
def spun(monkeypatch):
    """Run the main of the example; spin with some messages, and return the node."""

    def run(messages, **parameters):
        nodes = []
        monkeypatch.setattr(Node, "parameters", parameters)

        def spin(node):
            nodes.append(node)
            for topic, message in messages:
                node.callbacks[topic](message)

        modules = {
            "rclpy": {"init": lambda: None, "spin": spin, "try_shutdown": lambda: None},
            "rclpy.node": {"Node": Node},
            "rclpy.qos": {
                "QoSProfile": SimpleNamespace,
                "ReliabilityPolicy": SimpleNamespace(BEST_EFFORT="best effort"),
            },
            "rclpy.qos_overriding_options": {
                "QoSOverridingOptions": SimpleNamespace(
                    with_default_policies=lambda: "with default policies"
                )
            },
            "cv_bridge": {"CvBridge": CvBridge},
            "nav_msgs": {},
            "nav_msgs.msg": {"Odometry": object},
            "sensor_msgs": {},
            "sensor_msgs.msg": dict.fromkeys(
                ("Image", "CameraInfo", "PointCloud2", "PointField"), Made
            ),
            "tf2_msgs": {},
            "tf2_msgs.msg": {"TFMessage": object},
            "std_msgs": {},
            "std_msgs.msg": {"Header": Made},
            "diagnostic_msgs": {},
            "diagnostic_msgs.msg": dict.fromkeys(
                ("DiagnosticArray", "DiagnosticStatus", "KeyValue"), Made
            ),
            "sensor_msgs_py": {
                "point_cloud2": SimpleNamespace(
                    read_points_numpy=lambda message, fields, skip_nans: message.points
                )
            },
        }
        for name, members in modules.items():
            module = ModuleType(name)
            vars(module).update(members)
            monkeypatch.setitem(sys.modules, name, module)
        runpy.run_path(str(NODE), run_name="__main__")
        return nodes[0]

    return run


@pytest.mark.parametrize("parameters", [{}, {"fixed_frame": "odom", "memory_s": 2.0}])
def test_an_image_and_a_scan_are_answered(spun, parameters):
    frame = bundled_frames()[0]
    random = np.random.default_rng(0)
    points = random.uniform([4, -8, -1.5], [40, 8, 1], (5000, 3))  # x ahead, y left, z up
    place, turn = SimpleNamespace(x=1, y=2, z=3), SimpleNamespace(x=0, y=0, z=0, w=1)
    poses = {
        "odometry": stamped(
            pose=SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn))
        ),
        "/tf": SimpleNamespace(
            transforms=[
                stamped(
                    frame_id=fixed,
                    child_frame_id=child,
                    transform=SimpleNamespace(translation=place, rotation=turn),
                )
                for fixed, child in (("map", "odom"), ("odom", "base_link"))
            ]
        ),
    }
    topic = "/tf" if parameters else "odometry"
    messages = [
        (topic, poses[topic]),
        ("image", stamped(image=frame.rgb, frame_id="front_optical")),
        ("points", stamped(points=points, fields=())),
    ]
    with (
        pytest.warns(AssumptionWarning, match="the stamps of scans mark their middle"),
        pytest.warns(AssumptionWarning, match="the calibration fits images of"),
    ):
        node = spun(messages, **parameters)
    depth, semantic = node.sent["~/depth"], node.sent["~/semantic"]
    assert (depth.encoding, semantic.encoding) == ("32FC1", "mono8")
    assert depth.values.shape == semantic.values.shape == (256, 832)
    assert (depth.header.stamp.sec, depth.header.stamp.nanosec) == (SECONDS, NANOSECONDS)
    assert depth.header.frame_id == semantic.header.frame_id == "front_optical"
    cloud, camera = node.sent["~/points"], node.sent["~/camera_info"]
    assert cloud.header == camera.header == depth.header
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "rgb", "class", "uncertainty"]
    assert len(cloud.data) == cloud.row_step == cloud.width * cloud.point_step
    assert 1000 < cloud.width < depth.values.size / 2, "voxels"
    assert (camera.height, camera.width, camera.k[0]) == (256, 832, 721.5)
    keys = [{value.key for value in status.values} for status in node.statuses]
    assert any({"frame", "total_ms", "state"} <= each for each in keys)
    assert {status.level for status in node.statuses} <= {b"\0", b"\1", b"\2"}
    assert node.destroyed
    assert node.stream.counts.depths.answered == node.stream.counts.poses.answered == 1
    assert not [text for text in node.logged if "must" in text], node.logged
    assert node.stream.counts.poses.pushed == 1
