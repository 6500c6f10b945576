"""Scans of recordings, moved by the recording's poses to the time of the image."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from runtime import InputError, open_source
from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import PoseFrame
from runtime.geometry.rig import Rig
from runtime.recordings.bag import BagSource
from runtime.recordings.folders import FolderSource
from small_rig import INTRINSICS, MS, SIZE, SPEED, START_NS, BackwardsOdometry, agree, projected

DATA = os.environ.get("SSDNET_DATA")
N = 6

# LiDAR (x ahead, y left, z up) to camera: 0.5 m ahead of the LiDAR and 0.3 m below it.
EXTRINSICS = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, -0.5], [0, 0, 0, 1]])
REUSED = [(), ("depth_reused",)] * N


def seen(scan, ahead_m=0.0):
    """The scan of a car that drove `ahead_m` since."""
    return projected(scan, ahead_m=ahead_m + 0.5)


@pytest.fixture
def folders(tmp_path, make_frame, make_scan, write_rgb):
    """Twelve images at 20 Hz, of every second one a scan, at 15 m/s straight ahead."""
    (tmp_path / "points").mkdir()
    for number in range(2 * N):
        write_rgb(tmp_path / f"image/{number}.png", make_frame(*SIZE, seed=number)[0])
        if number % 2 == 0:
            make_scan(number).tofile(tmp_path / f"points/{number}.bin")
    times = [f"{100 + 0.05 * number:.3f}\n" for number in range(2 * N)]
    (tmp_path / "times.txt").write_text("".join(times))
    plain = f"intrinsics = {INTRINSICS}\nextrinsics = {EXTRINSICS.tolist()}\n"
    (tmp_path / "plain.toml").write_text(plain)
    body = "body_from_lidar = [[1.0,0,0,0],[0,1.0,0,0],[0,0,1.0,2.0],[0,0,0,1.0]]\n"
    (tmp_path / "calibration.toml").write_text(plain + body)
    write_poses(tmp_path / "poses.txt")
    return tmp_path


def write_poses(path):
    lines = []
    for metres in 0.05 * SPEED * np.arange(2 * N):
        pose = np.eye(4)
        pose[0, 3] = metres
        lines.append(" ".join(f"{number:.17g}" for number in pose[:3].ravel()))
    path.write_text("\n".join(lines) + "\n")


def read(folders, **changes):
    """The frames of the folders, with changed options; None = not given."""
    options = {"points": "points", "calibration": "calibration.toml", "timestamps": "times.txt"}
    options |= {"poses": "poses.txt", "pose_frame": PoseFrame.LIDAR} | changes
    paths = ("points", "calibration", "timestamps", "poses")
    given = {
        name: folders / value if name in paths else value
        for name, value in options.items()
        if value is not None
    }
    of_car = {name: given.pop(name) for name in FolderSource.rig_options if name in given}
    source = FolderSource(folders / "image", Rig(**of_car), **given)
    return [source.read(listed) for listed in source.list_frames()]


@pytest.fixture
def run_moved(folders, run):
    """Run ssdnet-run with the folders and their poses."""

    def run_folders(*arguments):
        keys = f"timestamps={folders / 'times.txt'},pose_frame=lidar"
        given = ["--source", f"folders:{folders / 'image'},{keys}", "--points", folders / "points"]
        given += ["--calibration", folders / "calibration.toml", "--poses", folders / "poses.txt"]
        answers = run(*given, *arguments)
        assert answers.exit_code == 0, answers.text
        return answers

    return run_folders


def test_a_run_moves_the_scans_of_images_at_twice_their_rate(run_moved, make_scan):
    answers = run_moved()
    assert answers.column("degraded") == ["", "depth_reused"] * N
    for number in range(2 * N):
        expected = seen(make_scan(number - number % 2), 0.05 * SPEED * (number % 2))
        assert agree(answers.fed_depth(str(number)), np.round(expected * 256) / 256)
    assert answers.column("depth_source") == ["own", "reused"] * N
    assert set(answers.column("depth_motion")) == {"scan"}
    assert [float(age) for age in answers.column("depth_age_ms")] == [0, 50] * N
    depth = {"own, motion scan": N, "reused, motion scan": N}
    assert answers.report["frames"]["depth"] == depth
    assert answers.report["stages"]["depth_age"]["max_ms"] == 50
    assert answers.report["stages"]["skew"]["n"] == N, "of own scans alone"


def test_a_run_that_remembers_counts_earlier_returns_apart(run_moved):
    answers = run_moved("--memory", 2)
    earlier, own = (list(map(int, answers.column(f"{of}_returns"))) for of in ("memory", "depth"))
    assert earlier[0] == 0
    assert sum(earlier) > 0
    for number in range(2 * N):
        assert np.count_nonzero(answers.fed_depth(str(number))) == earlier[number] + own[number]
    assert "earlier returns a frame" in answers.text
    assert "earlier returns a frame" in answers.report["frames"]["memory"]


@pytest.mark.parametrize(("stamp", "after_s"), [("start", 0.05), ("middle", 0), ("end", -0.05)])
def test_a_scan_is_of_its_middle(folders, make_scan, stamp, after_s):
    """Scans take 100 ms, as long as it is between two of them."""
    frames = read(folders, scan_stamp=stamp)
    assert agree(frames[5].sparse_depth, seen(make_scan(4), SPEED * (0.05 - after_s)))


def test_without_poses_an_older_scan_is_flagged_as_it_is(folders, make_scan):
    frames = read(folders, poses=None, pose_frame=None)
    assert [each.degraded for each in frames] == [(), ("depth_reused", "depth_uncompensated")] * N
    assert agree(frames[1].sparse_depth, seen(make_scan(0)))
    assert {each.depth_motion for each in frames} == {"none"}


def test_tums_poses_have_their_own_times(folders, make_scan):
    lines = [f"{100 + 0.01 * n:.2f} {0.01 * n * SPEED:.6f} 0 0 0 0 0 1" for n in range(60)]
    (folders / "tum.txt").write_text("# time x y z qx qy qz qw\n" + "\n".join(lines))
    frames = read(folders, poses="tum.txt")
    assert [each.degraded for each in frames] == REUSED
    assert agree(frames[3].sparse_depth, seen(make_scan(2), 0.05 * SPEED))
    (folders / "tum.txt").write_text("\n".join(line.replace("100.", "9900.") for line in lines))
    assert read(folders, poses="tum.txt")[2].degraded == ("depth_uncompensated", "pose_clock")


def test_each_return_is_moved_by_the_column_of_its_time(folders, make_scan):
    """Seconds after the stamp, in the fifth column; scans of 100 ms."""
    after_s = np.linspace(0, 0.1, 300, dtype=np.float32)
    for number in range(0, 2 * N, 2):
        scan = np.column_stack([make_scan(number), after_s]).astype(np.float32)
        scan.tofile(folders / f"points/{number}.bin")
    frames = read(folders, point_columns=5, point_time_column=4)
    assert {each.depth_motion for each in frames} == {"each"}
    scan = make_scan(2)
    scan[:, 0] += SPEED * after_s  # as seen from where the car was at the stamp
    assert agree(frames[3].sparse_depth, seen(scan, 0.05 * SPEED))
    with pytest.raises(InputError, match="point_time_column is 5"):
        read(folders, point_columns=5, point_time_column=5)


@pytest.mark.parametrize(("change", "message"), [
    ({"pose_frame": None}, "`poses=` and `pose_frame=`"),
    ({"poses": None}, "`poses=` and `pose_frame=`"),
    ({"timestamps": "short.txt"}, "short.txt has 2 lines, there are 12 images"),
    ({"timestamps": "back.txt"}, "line 2 of .*back.txt is '1.0', expected a later time"),
    ({"timestamps": "words.txt"}, "line 1 of .*words.txt is 'noon', expected seconds"),
    ({"poses": "short_poses.txt"}, "has 1 poses, there are 12 images"),
    ({"poses": "tum.txt", "timestamps": None}, "give `timestamps="),
    ({"poses": "scaled.txt"}, "pose must be rigid"),
    ({"pose_frame": PoseFrame.BODY, "calibration": "plain.toml"}, "body_from"),
    ({"points": None}, "give `points=`"),
    ({"scan_stamp": 3}, "scan_stamp"),
])  # fmt: skip
def test_what_does_not_fit_is_an_error_that_says_which(folders, change, message):
    (folders / "short.txt").write_text("1.0\n2.0\n")
    (folders / "back.txt").write_text("2.0\n1.0\n")
    (folders / "words.txt").write_text("noon\n")
    (folders / "short_poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folders / "tum.txt").write_text("1.0 0 0 0 0 0 0 1\n")
    (folders / "scaled.txt").write_text("2 0 0 0 0 2 0 0 0 0 2 0\n" * 2 * N)
    with pytest.raises(InputError, match=message):
        read(folders, **change)


def test_a_depth_map_is_reused_as_it_is_and_flagged(folders, write_depth, make_frame):
    for number in range(0, 2 * N, 2):
        write_depth(folders / f"depth/{number}.png", make_frame(*SIZE, seed=number)[1])
    source = FolderSource(folders / "image", Rig(reuse_depth_ms=150), depth=folders / "depth")
    frames = source.list_frames()
    assert "guessed: the images are 100 ms apart; `timestamps=` says when" in source.notes
    own, reused = (source.read(frame) for frame in frames[:2])
    assert (own.degraded, reused.depth_motion) == ((), "none")
    assert reused.degraded == ("depth_reused", "depth_uncompensated")
    assert np.array_equal(own.sparse_depth, reused.sparse_depth)


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
def test_moved_returns_lie_where_the_withheld_scan_has_them(tmp_path):
    """A drive at 1.1 m a frame; its poses were made from all scans, also from the missing ones."""
    recorded = Path(DATA or "") / "kitti_drive_0009"
    (tmp_path / "image").mkdir()
    (tmp_path / "points").mkdir()
    for number in range(20):
        (tmp_path / f"image/{number}.jpg").symlink_to(recorded / f"image_02/{number:010d}.jpg")
        if number % 2 == 0:
            scan = recorded / f"velodyne_fov/{number:010d}.bin"
            (tmp_path / f"points/{number}.bin").symlink_to(scan)
    for name in ("poses.txt", "image_02_timestamps.txt"):
        lines = (recorded / name).read_text().splitlines(keepends=True)[:20]
        (tmp_path / name).write_text("".join(lines))
    still = Rig(calibration=recorded)
    given = {"points": tmp_path / "points", "timestamps": tmp_path / "image_02_timestamps.txt"}
    poses = {"poses": tmp_path / "poses.txt"}
    own = FolderSource(recorded / "image_02", still, points=recorded / "velodyne_fov")
    errors = []
    for rig, moved in ((replace(still, pose_frame="lidar"), poses), (still, {})):
        source = FolderSource(tmp_path / "image", rig, **given, **moved)
        off = []
        for listed, truth in zip(source.list_frames(), own.list_frames(), strict=False):
            if listed.reused:
                depth, exact = source.read(listed).sparse_depth, own.read(truth).sparse_depth
                both = (depth > 0) & (exact > 0)
                off.append(abs(depth - exact)[both])
        # Road and walls along it look the same from further on: not the median.
        errors.append(np.percentile(np.concatenate(off), [75, 90]))
    assert (errors[0] < 0.7 * errors[1]).all(), errors


# --- bags ----------------------------------------------------------------------------------------


@pytest.fixture
def moving(record):
    """Give a bag of images at twice the rate of the scans, with poses."""

    def make(of="mcap", *, kind="odometry", child="base", fixed="odom"):
        bag = record(of, images=2 * N, scans=N, step_ms=50, late_ms=0)
        for step in range(80):
            stamp_ns, ahead = START_NS + (10 * step - 50) * MS, SPEED * (0.01 * step - 0.05)
            if kind == "odometry":
                bag.odometry("/odom", (ahead, 0.0, 0.0), stamp_ns, child=child)
            else:
                bag.transform(fixed, child, (0.0, 0.0, 0.0, 1.0), (ahead, 0.0, 0.0), stamp_ns)
                bag.transform("map", "odom", (0.0, 0.0, 0.0, 1.0), (5.0, 0.0, 0.0), stamp_ns)
        return bag

    return make


@pytest.mark.parametrize(("of", "kind", "topic"), [
    ("ros1", "tf", "/tf"), ("mcap", "tf", "/tf"), ("ros2", "odometry", "/odom"),
])  # fmt: skip
def test_a_bag_is_moved_by_its_own_poses(moving, make_scan, of, kind, topic):
    with BagSource(moving(of, kind=kind).write(), Rig(max_skew_ms=20)) as source:
        frames = [source.read(listed) for listed in source.list_frames()]
        assert source.inputs["pose_topic"] == topic
        assert f"pose_topic={topic}" in source.notes[0]
    assert [each.degraded for each in frames] == REUSED
    for index in (1, 2, 3):
        expected = seen(make_scan(index // 2), 0.05 * SPEED * (index % 2))
        assert agree(frames[index].sparse_depth, expected)


def test_clouds_with_a_time_for_each_point_are_deskewed(moving, make_scan):
    bag, scan = moving(), make_scan(7)
    bag.messages = [each for each in bag.messages if each[0] != "/lidar/points"]
    scan[:, 3] = np.linspace(0, 0.1, 300)
    bag.cloud("/lidar/points", scan, START_NS + 100 * MS, fourth="time")
    with BagSource(bag.write(), Rig(max_skew_ms=20)) as source:
        frame = source.read(source.list_frames()[3])
    assert (frame.depth_motion, frame.reused) == ("each", True)
    scan[:, 0] += SPEED * scan[:, 3]
    assert agree(frame.sparse_depth, seen(scan, 0.05 * SPEED))


@pytest.mark.parametrize(("poses", "note"), [
    ({"child": "elsewhere"}, "/tf_static does not connect the frame 'lidar' to 'elsewhere'"),
    ({"kind": "tf", "child": "elsewhere"}, "/tf moves none of the frames lidar, base"),
    ({"kind": "tf", "fixed": "footprint"}, "'footprint', which moves itself in 'odom'"),
])  # fmt: skip
def test_a_bag_says_why_its_poses_are_not_used(moving, poses, note):
    bag = moving(**poses)
    bag.transform("odom", "footprint", (0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0), START_NS)
    path = bag.write()
    with BagSource(path, Rig(max_skew_ms=20)) as source:
        frame = source.read(source.list_frames()[1])
        assert frame.degraded == ("depth_reused", "depth_uncompensated")
        assert any(note in line for line in source.notes), source.notes
    topic = "/tf" if poses.get("kind") == "tf" else "/odom"
    with pytest.raises(InputError, match=note.partition(" the frame")[0]):
        BagSource(path, pose_topic=topic)
    with BagSource(path, pose_topic="none") as source:
        assert source.notes[0].startswith("topics")


def test_one_of_several_topics_of_odometry_is_chosen(moving):
    bag = moving()
    bag.odometry("/gps/odom", (0.0, 0.0, 0.0), START_NS)
    path = bag.write()
    with BagSource(path) as source:
        assert any("/gps/odom, /odom by `pose_topic=" in note for note in source.notes)
        assert source.inputs["pose_topic"] is None
    with BagSource(path, pose_topic="/odom") as source:
        assert source.inputs["pose_topic"] == "/odom"
    with pytest.raises(InputError, match="pose_topic=/imu"):
        BagSource(path, pose_topic="/imu")


class KnownOdometry:
    """Takes the distance that was driven from the only point, of a wall 20 m ahead at first."""

    def add(self, points):
        pose = np.eye(4)
        pose[0, 3] = 20 - points[0, 0]
        return pose


def test_a_folder_gets_its_poses_from_its_scans(tmp_path, make_frame, write_rgb, monkeypatch):
    monkeypatch.setattr("runtime.recordings.folders.Odometry", KnownOdometry)
    (tmp_path / "points").mkdir()
    for number in range(4):
        write_rgb(tmp_path / f"image/{number}.png", make_frame(48, 64, seed=number)[0])
        if number != 2:  # it takes the scan before, moved to its time
            points = np.array([[20.0 - 1.5 * number, 0, 0, 0]], np.float32)
            points.tofile(tmp_path / f"points/{number}.bin")
    rig = Rig(calibration=Calibration(np.array(INTRINSICS), EXTRINSICS), scan_stamp="middle")
    files = {"points": tmp_path / "points", "poses": "odometry"}
    with open_source("folders", tmp_path / "image", rig, **files) as source:
        frames = [source.read(frame) for frame in source.list_frames()]
    depths = [frame.sparse_depth.max() for frame in frames]
    assert depths == pytest.approx([19.5, 18, 16.5, 15], abs=0.01)
    assert frames[2].depth_motion == "scan"
    with pytest.raises(InputError, match="leave pose_frame out"):
        open_source("folders", tmp_path / "image", replace(rig, pose_frame="body"), **files)


@pytest.mark.parametrize("of", ["ros1", "mcap"])
def test_odometry_replaces_the_poses_of_a_bag(moving, make_scan, monkeypatch, of):
    """The odometry drives backwards, the bag's poses ahead."""
    monkeypatch.setattr("runtime.recordings.bag.Odometry", BackwardsOdometry)
    path = moving(of).write()
    with BagSource(path, Rig(max_skew_ms=20), pose_topic="odometry") as source:
        frames = [source.read(listed) for listed in source.list_frames()]
        assert source.inputs["pose_topic"] == "odometry"
        assert any("of the bag, if any, are not used" in note for note in source.notes)
    for index in (1, 2, 3):
        expected = seen(make_scan(index // 2), -0.05 * SPEED * (index % 2))
        assert agree(frames[index].sparse_depth, expected)
