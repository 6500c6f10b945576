"""Small recordings, and what ssdnet-run answers to them."""

import csv
import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from runtime.app.run.cli import app
from small_rig import INTRINSICS, MS, SIZE, START_NS, add_tree


@pytest.fixture
def make_scan():
    """Give float32 (n, 4): x ahead, y to the left, z up [m], reflectance."""

    def make(seed: int = 0, n: int = 300) -> np.ndarray:
        random = np.random.default_rng(seed)
        x = random.uniform(5, 40, n)
        y, z = x * random.uniform(-0.5, 0.5, n), x * random.uniform(-0.3, 0.3, n)
        return np.stack([x, y, z, random.random(n)], axis=1).astype(np.float32)

    return make


class Answers:
    """What a run left: exit code, text, report, rows, and the depth that the network was fed."""

    def __init__(self, result, out) -> None:
        self.exit_code, self.text, self._out = result.exit_code, result.output, out
        if (out / "report.json").exists():
            self.report = json.loads((out / "report.json").read_text())
            self.rows = list(csv.DictReader((out / "frames.csv").read_text().splitlines()))
            self.names = [row["name"] for row in self.rows]

    def fed_depth(self, name):
        """The model by hand answers what it is fed and 1.5 m more; a PNG rounds to 1/256 m."""
        answer = cv2.imread(str(self._out / f"depth/{name}.png"), cv2.IMREAD_UNCHANGED) / 256
        return answer - 1.5

    def require(self, expected):
        """All frames are answered, each from the depth that is expected under its name."""
        assert self.exit_code == 0, self.text
        assert self.names == list(expected)
        for name, depth in expected.items():
            assert np.count_nonzero(depth) > 100
            assert abs(self.fed_depth(name) - depth).max() < 0.01

    def column(self, name):
        return [row[name] for row in self.rows]


@pytest.fixture
def run(tmp_path, model_file):
    """Run ssdnet-run with the model by hand and give its Answers."""
    model = model_file(heads=("semantic", "depth"))  # lossy pictures have no boundary by hand

    def invoke(*arguments: object, out="out"):
        standard = ["--model", model, "--out", tmp_path / out, "--threads", 1, "--warmup", 1]
        standard += ["--save", "depth"]
        result = CliRunner().invoke(app, [str(a) for a in [*standard, *arguments]])
        return Answers(result, tmp_path / out)

    return invoke


@pytest.fixture
def write_rgb():
    """Write a picture, red first."""

    def write(path, rgb):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), rgb[..., ::-1])

    return write


@pytest.fixture
def write_depth():
    """Write a 16-bit PNG."""

    def write(path, metres):
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), np.rint(metres * 256).astype(np.uint16))

    return write


def header(stamp_ns, frame_id):
    stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    return {"stamp": stamp, "frame_id": frame_id}


def vector(values):
    return dict(zip("xyzw", map(float, values), strict=False))


class BagMaker:
    """Collects messages, then writes them into a bag of one of KINDS in the order of recording."""

    def __init__(self, folder, kind) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.kind, self._folder = kind, folder
        self.is_ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
        self.messages = []  # topic, type, raw, recorded_ns

    def make(self, kind, given):
        """A message with the fields that are given, by name; the others are 0 or empty."""
        fields = {}
        for name, (node, inner) in self.store.fielddefs[kind][1]:
            value = given.get(name, given.get(name.lower()))  # CameraInfo of ROS 1 has capitals
            if node.name == "NAME":
                fields[name] = self.make(inner, value or {})
            elif node.name == "BASE":
                fields[name] = value if value is not None else "" if inner[0] == "string" else 0
            elif inner[0][0].name == "NAME":
                fields[name] = [self.make(inner[0][1], each) for each in value]
            else:
                content = np.zeros(inner[1]) if value is None else value
                fields[name] = np.asarray(content, inner[0][1][0]).reshape(-1)
        return self.store.types[kind](**fields)

    def send(self, kind, topic, stamp_ns, given, recorded_ns=None):
        message = self.make(kind, given)
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        raw = bytes(serialize(message, kind))
        self.messages.append((topic, kind, raw, recorded_ns or stamp_ns))

    def image(self, topic, array, encoding, stamp_ns, *, frame_id="camera", recorded_ns=None):
        height, width = array.shape[:2]
        fields = {"header": header(stamp_ns, frame_id), "height": height, "width": width}
        fields["data"] = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        fields |= {"encoding": encoding, "step": array[0].nbytes}
        self.send("sensor_msgs/msg/Image", topic, stamp_ns, fields, recorded_ns)

    def compressed(self, topic, content, text, stamp_ns):
        fields = {"header": header(stamp_ns, "camera"), "format": text}
        fields["data"] = np.frombuffer(content, np.uint8)
        self.send("sensor_msgs/msg/CompressedImage", topic, stamp_ns, fields)

    def cloud(
        self, topic, points, stamp_ns, *, fourth="intensity", recorded_ns=None, frame_id="lidar"
    ):
        """points: (N, 4) of x, y, z and the fourth; written as float32 with a gap of 4 bytes."""
        records = np.zeros((len(points), 5), np.float32)
        records[:, [0, 1, 2, 4]] = points
        fields = {"header": header(stamp_ns, frame_id), "height": 1, "width": len(points)}
        places = {"x": 0, "y": 4, "z": 8, fourth: 16}.items()
        kind = {"datatype": 7, "count": 1}
        fields["fields"] = [{"name": name, "offset": place, **kind} for name, place in places]
        fields |= {"point_step": 20, "row_step": 20 * len(points)}
        fields["data"] = records.reshape(-1).view(np.uint8)
        self.send("sensor_msgs/msg/PointCloud2", topic, stamp_ns, fields, recorded_ns)

    def info(self, topic, k, size, *, frame_id="camera", stamp_ns=1, **given):
        """given: fields; of P: `rectified` (its first three columns, else K) and `shift_px`."""
        shift = [[given.pop("shift_px", 0.0)], [0], [0]]
        fields = {"header": header(stamp_ns, frame_id), "height": size[0], "width": size[1]}
        fields |= {"distortion_model": "plumb_bob", "k": k, "d": [], "r": np.eye(3)}
        fields["p"] = np.hstack([given.pop("rectified", k), shift])
        self.send("sensor_msgs/msg/CameraInfo", topic, stamp_ns, fields | given)

    def odometry(
        self, topic, position, stamp_ns, *, child="base", turn=(0, 0, 0, 1), speed=(0, 0, 0)
    ):
        pose = {"position": vector(position), "orientation": vector(turn)}
        fields = {"header": header(stamp_ns, "odom"), "child_frame_id": child}
        fields["twist"] = {"twist": {"linear": vector(speed)}}
        self.send("nav_msgs/msg/Odometry", topic, stamp_ns, fields | {"pose": {"pose": pose}})

    def static_transform(self, parent, child, quaternion, shift):
        self.transform(parent, child, quaternion, shift, 1, topic="/tf_static")

    def transform(self, parent, child, quaternion, shift, stamp_ns, *, topic="/tf"):
        stamped = {"header": header(stamp_ns, parent), "child_frame_id": child}
        stamped["transform"] = {"translation": vector(shift), "rotation": vector(quaternion)}
        self.send("tf2_msgs/msg/TFMessage", topic, stamp_ns, {"transforms": [stamped]})

    def write(self, name="drive", *, compression=None):
        """Write the bag and give back what --source takes.

        compression: of ROS 1 "bz2" or "lz4"; of ROS 2 "storage" (of MCAP its chunks) or "message"
        """
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        path = self._folder / (f"{name}.bag" if self.is_ros1 else f"{name}-{self.kind}")
        if self.is_ros1:
            writer = Writer1(path)
        else:
            plugin = StoragePlugin.SQLITE3 if self.kind == "ros2" else StoragePlugin.MCAP
            writer = Writer2(path, version=9, storage_plugin=plugin)
        if compression is not None and self.is_ros1:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        elif compression is not None:
            mode = CompressionMode[compression.upper()]
            writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for topic, kind, raw, recorded_ns in sorted(self.messages, key=lambda m: m[3]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], recorded_ns, raw)
        if self.kind == "mcap":  # the file alone, as recorders of others leave it
            return next(path.glob("*.mcap"))
        return path


@pytest.fixture
def make_bag(tmp_path):
    """Give a BagMaker of a kind: "ros1", "ros2" (sqlite3 in its folder) or "mcap" (one file)."""
    pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")
    return lambda kind="mcap": BagMaker(tmp_path, kind)


@pytest.fixture
def record(make_bag, make_frame, make_scan):
    """Give a BagMaker with the small rig: images at `step_ms`, scans at 10 Hz, `late_ms` later."""

    def fill(kind="mcap", *, images=4, scans=4, step_ms=100, late_ms=7, tree=True):
        bag = make_bag(kind)
        for index in range(images):
            stamp_ns = START_NS + step_ms * MS * index
            bag.image("/cam/image_rect", make_frame(*SIZE, seed=index)[0], "rgb8", stamp_ns)
        bag.info("/cam/camera_info", INTRINSICS, SIZE)
        for index in range(scans):
            bag.cloud("/lidar/points", make_scan(index), START_NS + (100 * index + late_ms) * MS)
        if tree:
            add_tree(bag)
        return bag

    return fill
