"""The answers of a run as an MCAP file with the standard messages of ROS 2 (extra `bag`)."""

import contextlib
import json
import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from runtime.app.run.options import DEFAULT_RATE_HZ, FILE_SUFFIXES, MCAP_VOXEL_M
from runtime.app.run.outputs.run_context import RunContext, camera_of
from runtime.base.errors import OutputError
from runtime.contract.heads import HEADS, Unit
from runtime.drawing.encode import METRES_PNG_SCALE, encode_jpeg, encode_ros_image
from runtime.files.atomic_write import atomic_path
from runtime.recordings.ros_answers import camera_fields, cloud_fields, status_fields
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult

_OVERLAY_TOPIC = "/ssdnet/overlay/compressed"
_CLASSES_TOPIC, _SCALES_TOPIC = "/ssdnet/classes", "/ssdnet/scales"
_POINTS_TOPIC, _CAMERA_TOPIC = "/ssdnet/points", "/ssdnet/camera_info"
_DIAGNOSTICS_TOPIC, _STATIC_TOPIC = "/diagnostics", "/tf_static"
_SCALES = {Unit.METRES: METRES_PNG_SCALE, Unit.PROBABILITY: 255}
_S = 1_000_000_000  # nanoseconds
_LAST_NS = 2**31 * _S  # a builtin_interfaces/msg/Time has 32 bits for the seconds


class McapWriter:
    """Appends the messages of each frame; see `open_mcap`."""

    def __init__(self, bag: Any, run: RunContext) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._bag, self._run, self._contract = bag, run, run.predictor.contract
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Any] = {}
        self._frames = 0

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Append the answers to a frame. Raises OutputError if ROS cannot hold the stamp."""
        prediction, stamp_ns = result.prediction, frame.image.stamp_ns
        if stamp_ns is None:
            stamp_ns = round(self._frames / (self._run.options.rate or DEFAULT_RATE_HZ) * _S)
        if not 0 <= stamp_ns < _LAST_NS:
            raise OutputError(
                f"{frame.name} has the stamp {stamp_ns} ns, ROS takes 0 to {_LAST_NS - 1}: "
                "leave out --mcap, or correct the stamps of the source"
            )
        header = self._header(stamp_ns, self._run.sensors.camera)
        if not self._frames:
            self._write_once(stamp_ns)
        self._frames += 1
        for head, values in prediction.heads.items():
            if not HEADS[head].per_class:
                unit = HEADS[head].unit
                self._run.count_beyond(f"{head} in the MCAP file", unit, values)
                topic = f"/ssdnet/{head}/compressed"
                self._add_image(topic, header, *encode_ros_image(unit, values))
        self._add_image(_OVERLAY_TOPIC, header, "jpeg", encode_jpeg(self._run.draw(frame, result)))
        camera = camera_of(frame, self._run.predictor.focal_length_px)
        if camera is not None:
            roi = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
            fields = {**camera_fields(camera, frame.size), "roi": roi}
            self._add(_CAMERA_TOPIC, "sensor_msgs/msg/CameraInfo", stamp_ns, header, **fields)
        cloud = self._run.cloud(frame, prediction, voxel_m=MCAP_VOXEL_M)
        if cloud is not None:
            fields = cloud_fields(cloud)
            of_field = "sensor_msgs/msg/PointField"
            fields["fields"] = [self._make(of_field, **each) for each in fields["fields"]]
            self._add(_POINTS_TOPIC, "sensor_msgs/msg/PointCloud2", stamp_ns, header, **fields)
        status, of_value = status_fields(result), "diagnostic_msgs/msg/KeyValue"
        status["values"] = [self._make(of_value, *pair) for pair in status["values"].items()]
        status |= {"name": "ssdnet", "hardware_id": self._contract.model_name}
        diagnostic = self._make("diagnostic_msgs/msg/DiagnosticStatus", **status)
        of_type = "diagnostic_msgs/msg/DiagnosticArray"
        self._add(_DIAGNOSTICS_TOPIC, of_type, stamp_ns, header, status=[diagnostic])

    def _write_once(self, stamp_ns: int) -> None:
        """Append what is the same for all frames: classes, scales, and where the sensors are."""
        names = {index: info.name for index, info in enumerate(self._contract.classes)}
        scales = {name: _SCALES[head.unit] for name, head in HEADS.items() if head.unit in _SCALES}
        for topic, facts in ((_CLASSES_TOPIC, names), (_SCALES_TOPIC, scales)):
            self._add(topic, "std_msgs/msg/String", stamp_ns, data=json.dumps(facts))
        transforms, of_type = [], "geometry_msgs/msg/TransformStamped"
        for each in self._run.sensors.transforms:
            vector = self._make("geometry_msgs/msg/Vector3", *each.translation)
            turn = self._make("geometry_msgs/msg/Quaternion", *each.rotation)
            place = self._make("geometry_msgs/msg/Transform", vector, turn)
            header = self._header(stamp_ns, each.parent)
            transforms.append(self._make(of_type, header, each.child, place))
        if transforms:
            self._add(_STATIC_TOPIC, "tf2_msgs/msg/TFMessage", stamp_ns, transforms=transforms)

    def _make(self, of_type: str, *values: Any, **fields: Any) -> Any:
        return self._typestore.types[of_type](*values, **fields)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, _S))
        return self._make("std_msgs/msg/Header", time, frame_id)

    def _add_image(self, topic: str, header: Any, form: str, content: memoryview) -> None:
        stamp_ns = header.stamp.sec * _S + header.stamp.nanosec
        data = np.frombuffer(content, np.uint8)
        of_type = "sensor_msgs/msg/CompressedImage"
        self._add(topic, of_type, stamp_ns, header, format=form, data=data)

    def _add(self, topic: str, of_type: str, stamp_ns: int, *header: Any, **fields: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(
                topic,
                of_type,
                typestore=self._typestore,
                offered_qos_profiles=[_latched()] if topic == _STATIC_TOPIC else (),
            )
        message = self._make(of_type, *header, **fields)
        content = self._typestore.serialize_cdr(message, of_type)
        self._bag.write(self._connections[topic], stamp_ns, content)


def _latched() -> Any:
    """The quality of service of /tf_static: later subscribers get the last message."""
    from rosbags import interfaces

    kept = interfaces.QosHistory.KEEP_LAST, 1
    sent = interfaces.QosReliability.RELIABLE, interfaces.QosDurability.TRANSIENT_LOCAL
    ever = interfaces.QosTime(2**31 - 1, 2**32 - 1)
    return interfaces.Qos(*kept, *sent, ever, ever, interfaces.QosLiveliness.AUTOMATIC, ever, False)


@contextlib.contextmanager
def open_mcap(run: RunContext) -> Iterator[McapWriter]:
    """Make the file of --mcap; frames without stamps are --rate apart, the first of them at 0.

    A run without any frame leaves no file.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    assert run.options.mcap is not None
    with atomic_path(run.options.mcap, overwrite=run.options.overwrite) as temporary:
        folder = temporary.with_suffix("")
        bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with bag:
            writer = McapWriter(bag, run)
            yield writer
        if writer._frames:
            os.replace(folder / f"{folder.name}{FILE_SUFFIXES['mcap']}", temporary)
