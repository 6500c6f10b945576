"""The answers of a run as an MCAP file of ROS 2's standard messages (extra `bag`)."""

import contextlib
import json
import os
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from runtime.app.encode import encode_jpeg
from runtime.app.run.options import DEFAULT_RATE_HZ, FILE_SUFFIXES
from runtime.app.run.outputs.output import OpenRun
from runtime.base.errors import OutputError
from runtime.contract.heads import HEADS
from runtime.engine.prediction import Prediction
from runtime.files.atomic_write import atomic_path
from runtime.streams.frame import Frame
from runtime.streams.frame_result import FrameResult

_ENCODINGS = {"uint8": "mono8", "float32": "32FC1"}  # dtype -> encoding of sensor_msgs/msg/Image
#: Head that is a picture -> topic and encoding of its `sensor_msgs/msg/Image`.
IMAGES = {
    head.name: (f"/ssdnet/{head.name}", _ENCODINGS[head.dtype])
    for head in HEADS.values()
    if not head.per_class
}
OVERLAY, CLASSES, DIAGNOSTICS = "/ssdnet/overlay/compressed", "/ssdnet/classes", "/diagnostics"
_S = 1_000_000_000  # nanoseconds
_LAST_NS = 2**31 * _S  # builtin_interfaces/msg/Time has 32 bits for the seconds


class McapWriter:
    """Append the messages of each frame; see `open_mcap`."""

    def __init__(self, bag: Any, run: OpenRun) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._bag, self._run, self._contract = bag, run, run.predictor.contract
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._types = self._typestore.types
        self._connections: dict[str, Any] = {}
        self._frames = 0

    def write(self, frame: Frame, result: FrameResult) -> None:
        """Append the answers to a frame. Raises OutputError for a stamp out of range for ROS."""
        prediction, stamp_ns = result.prediction, frame.image.stamp_ns
        if frame.image.stamp is None:
            stamp_ns = round(self._frames / (self._run.options.rate or DEFAULT_RATE_HZ) * _S)
        if not 0 <= stamp_ns < _LAST_NS:
            raise OutputError(
                f"{frame.name} has the stamp {stamp_ns} ns, ROS takes 0 to {_LAST_NS - 1}: "
                "leave out --mcap, or correct the stamps of the source"
            )
        if not self._frames:
            names = {index: info.name for index, info in enumerate(self._contract.classes)}
            self._add(CLASSES, "std_msgs/msg/String", stamp_ns, data=json.dumps(names))
        self._frames += 1
        time = self._types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, _S))
        header = self._types["std_msgs/msg/Header"](time, "camera")
        for head, (topic, encoding) in IMAGES.items():
            image = prediction.heads.get(head)
            if image is not None:
                self._add(
                    topic,
                    "sensor_msgs/msg/Image",
                    stamp_ns,
                    header=header,
                    height=image.shape[0],
                    width=image.shape[1],
                    encoding=encoding,
                    is_bigendian=0,
                    step=image.shape[1] * image.itemsize,
                    data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
                )
        overlay = encode_jpeg(self._run.draw(frame, result))
        self._add(
            OVERLAY,
            "sensor_msgs/msg/CompressedImage",
            stamp_ns,
            header=header,
            format="jpeg",
            data=np.frombuffer(overlay, np.uint8),
        )
        self._add(
            DIAGNOSTICS,
            "diagnostic_msgs/msg/DiagnosticArray",
            stamp_ns,
            header=header,
            status=[self._status(frame.name, prediction)],
        )

    def _status(self, name: str, prediction: Prediction) -> Any:
        of_type: Any = self._types["diagnostic_msgs/msg/DiagnosticStatus"]
        values = {
            "frame": name,
            **{stage: f"{ms:.3f}" for stage, ms in asdict(prediction.latency).items()},
            "depth_returns": str(prediction.depth_returns),
            "depth_cleaned": str(prediction.cleaned.total),
        }
        key_value = self._types["diagnostic_msgs/msg/KeyValue"]
        return of_type(
            level=of_type.WARN if prediction.degraded else of_type.OK,
            name="ssdnet",
            message=", ".join(prediction.degraded) or "ok",
            hardware_id=self._contract.model_name,
            values=[key_value(key, value) for key, value in values.items()],
        )

    def _add(self, topic: str, of_type: str, stamp_ns: int, **fields: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._bag.add_connection(
                topic, of_type, typestore=self._typestore
            )
        message = self._types[of_type](**fields)
        content = self._typestore.serialize_cdr(message, of_type)
        self._bag.write(self._connections[topic], stamp_ns, content)


@contextlib.contextmanager
def open_mcap(run: OpenRun) -> Iterator[McapWriter]:
    """Make the file of --mcap; frames without stamps are at --rate, the first of them at 0.

    A run without a frame leaves no file there.
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
