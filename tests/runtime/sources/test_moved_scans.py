"""Scans of recordings, moved by the recording's poses to the time of the image."""

import numpy as np
import pytest
import small_rig
from small_rig import INTRINSICS, MS, SIZE, START_NS, add_tree

from runtime import InputError
from runtime.sources.bag import BagSource
from runtime.sources.folders import FolderSource
from runtime.sources.kitti_raw import KittiRawSource

N = 6
SPEED = 15.0

#: LiDAR (x ahead, y left, z up) to camera: 0.5 m ahead of the LiDAR and 0.3 m below it.
EXTRINSICS = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, -0.5], [0, 0, 0, 1]])


def projected(scan, ahead_m=0.0):
    """The scan of a car that drove `ahead_m` since."""
    return small_rig.projected(scan, ahead_m=ahead_m + 0.5)


def agree(depth, expected):
    """Whether two maps are the same, but for returns that float32 rounds to the next pixel."""
    same = (depth > 0) == (expected > 0)
    both = (depth > 0) & (expected > 0)
    return same.mean() > 0.995 and np.median(abs(depth - expected)[both]) < 1e-3


@pytest.fixture
def folders(tmp_path, make_frame, make_scan, write_rgb):
    """Twelve images at 20 Hz, of every second one a scan, at 15 m/s straight ahead."""
    for number in range(2 * N):
        rgb, _ = make_frame(*SIZE, seed=number)
        write_rgb(tmp_path / f"image/{number}.png", rgb)
        if number % 2 == 0:
            (tmp_path / "points").mkdir(exist_ok=True)
            make_scan(number).tofile(tmp_path / f"points/{number}.bin")
    (tmp_path / "times.txt").write_text(
        "".join(f"{100 + 0.05 * number:.3f}\n" for number in range(2 * N))
    )
    (tmp_path / "calibration.toml").write_text(
        f"intrinsics = {INTRINSICS}\nextrinsics = {EXTRINSICS.tolist()}\n"
        "body_from_lidar = [[1.0,0,0,0],[0,1.0,0,0],[0,0,1.0,2.0],[0,0,0,1.0]]\n"
    )
    write_poses(tmp_path / "poses.txt", 0.05 * SPEED * np.arange(2 * N))
    return tmp_path


def write_poses(path, ahead_m, *, frame="lidar"):
    lines = []
    for metres in ahead_m:
        pose = np.eye(4)
        pose[0, 3] = metres
        if frame == "camera":  # of the camera, in the frame of its first pose
            pose = EXTRINSICS @ pose @ np.linalg.inv(EXTRINSICS)
        lines.append(" ".join(f"{number:.17g}" for number in pose[:3].ravel()))
    path.write_text("\n".join(lines) + "\n")


def arguments(folders, *, poses="poses.txt", frame="lidar", keys=""):
    keys = f"timestamps={folders / 'times.txt'}{f',pose_frame={frame}' if poses else ''}{keys}"
    given = ["--source", f"folders:{folders / 'image'},{keys}", "--points", folders / "points"]
    given += ["--calibration", folders / "calibration.toml"]
    return [*given, *(["--poses", folders / poses] if poses else [])]


@pytest.mark.parametrize("frame", ["lidar", "camera", "body"])
def test_images_at_twice_the_rate_of_the_scans_have_moved_returns(folders, run, make_scan, frame):
    write_poses(folders / "poses.txt", 0.05 * SPEED * np.arange(2 * N), frame=frame)
    answers = run(*arguments(folders, frame=frame))
    assert answers.exit_code == 0, answers.text
    assert answers.column("degraded") == ["", "depth_reused"] * N
    for number in range(2 * N):
        expected = projected(make_scan(number - number % 2), 0.05 * SPEED * (number % 2))
        assert agree(answers.fed_depth(str(number)), np.round(expected * 256) / 256)
    assert answers.column("depth_source") == ["own", "reused"] * N
    assert set(answers.column("depth_motion")) == {"scan"}
    assert [float(age) for age in answers.column("depth_age_ms")] == [0, 50] * N
    assert answers.report["frames"]["depth"] == {
        "own, motion scan": N,
        "reused, motion scan": N,
    }
    assert answers.report["stages"]["depth_age"]["max_ms"] == 50
    assert answers.report["stages"]["skew"]["n"] == N, "of own scans alone"


def test_without_poses_an_older_scan_is_flagged_as_it_is(folders, run, make_scan):
    answers = run(*arguments(folders, poses=None))
    assert answers.exit_code == 0, answers.text
    assert answers.column("degraded") == ["", "depth_reused;depth_uncompensated"] * N
    assert agree(answers.fed_depth("1"), np.round(projected(make_scan(0)) * 256) / 256)
    assert set(answers.column("depth_motion")) == {"none"}


def test_tums_poses_have_their_own_times(folders, run, make_scan):
    lines = [f"{100 + 0.01 * n:.2f} {0.01 * n * SPEED:.6f} 0 0 0 0 0 1" for n in range(60)]
    (folders / "tum.txt").write_text("# time x y z qx qy qz qw\n" + "\n".join(lines))
    answers = run(*arguments(folders, poses="tum.txt"))
    assert answers.column("degraded") == ["", "depth_reused"] * N
    expected = projected(make_scan(2), 0.05 * SPEED)
    assert agree(answers.fed_depth("3"), np.round(expected * 256) / 256)
    (folders / "tum.txt").write_text("\n".join(line.replace("100.", "9900.") for line in lines))
    other = run(*arguments(folders, poses="tum.txt"), out="other")
    assert set(other.column("degraded")[2:]) >= {"depth_uncompensated;pose_clock"}


def test_each_return_is_moved_by_the_column_of_its_time(folders, run, make_scan):
    """Seconds after the stamp, in the fifth column; scans of 100 ms."""
    after_s = np.linspace(0, 0.1, 300, dtype=np.float32)
    for number in range(0, 2 * N, 2):
        scan = np.column_stack([make_scan(number), after_s]).astype(np.float32)
        scan.tofile(folders / f"points/{number}.bin")
    keys = ",point_columns=5,point_time_column="
    answers = run(*arguments(folders, keys=f"{keys}4"))
    assert answers.exit_code == 0, answers.text
    assert set(answers.column("depth_motion")) == {"each"}
    scan = make_scan(2)
    scan[:, 0] += SPEED * after_s  # as seen from where the car was at the stamp
    expected = projected(scan, 0.05 * SPEED)
    assert agree(answers.fed_depth("3"), np.round(expected * 256) / 256)
    beyond = run(*arguments(folders, keys=f"{keys}5"), out="no")
    assert beyond.exit_code == 3 or "point_time_column is 5" in beyond.text


@pytest.mark.parametrize(("change", "message"), [
    ({"poses": "poses.txt"}, "--poses and pose_frame= in --source together"),
    ({"pose_frame": "lidar"}, "--poses and pose_frame= in --source together"),
    ({"timestamps": "short.txt"}, "short.txt has 2 lines, there are 12 images"),
    ({"timestamps": "back.txt"}, "line 2 of .*back.txt is '1.0', expected a later time"),
    ({"timestamps": "words.txt"}, "line 1 of .*words.txt is 'noon', expected seconds"),
    ({"poses": "short_poses.txt", "pose_frame": "lidar"}, "has 1 poses, there are 12 images"),
    ({"poses": "tum.txt", "pose_frame": "lidar", "timestamps": None}, "give timestamps="),
    ({"poses": "scaled.txt", "pose_frame": "lidar"}, "pose must be rigid"),
    ({"poses": "poses.txt", "pose_frame": "body", "calibration": "plain.toml"}, "body_from"),
    ({"points": None, "poses": "poses.txt", "pose_frame": "lidar"}, "give --points"),
])  # fmt: skip
def test_what_does_not_fit_is_an_error_that_says_which(folders, change, message):
    (folders / "short.txt").write_text("1.0\n2.0\n")
    (folders / "back.txt").write_text("2.0\n1.0\n")
    (folders / "words.txt").write_text("noon\n")
    write_poses(folders / "short_poses.txt", [0.0])
    (folders / "tum.txt").write_text("1.0 0 0 0 0 0 0 1\n")
    (folders / "scaled.txt").write_text("2 0 0 0 0 2 0 0 0 0 2 0\n" * 2 * N)
    (folders / "plain.toml").write_text(
        f"intrinsics = {INTRINSICS}\nextrinsics = {EXTRINSICS.tolist()}\n"
    )
    options = {"points": "points", "calibration": "calibration.toml", "timestamps": "times.txt"}
    options |= change
    given = {
        name: value if name == "pose_frame" else folders / value
        for name, value in options.items()
        if value is not None
    }
    with pytest.raises(InputError, match=message):
        FolderSource(folders / "image", **given).list_frames()


# --- KITTI raw -----------------------------------------------------------------------------------


@pytest.fixture
def drive(tmp_path, make_frame, make_scan, write_rgb):
    """Images at 20 Hz, scans at 10 Hz, oxts at 20 Hz; the car drives to the east, which is x."""
    folder = tmp_path / "2011_09_26/2011_09_26_drive_0001_sync"
    for name in ("velodyne_points/data", "oxts/data"):
        (folder / name).mkdir(parents=True)
    date = "2011-09-26 13:02:{:06.3f}\n"
    for number in range(2 * N):
        rgb, _ = make_frame(*SIZE, seed=number)
        write_rgb(folder / f"image_02/data/{number:010d}.png", rgb)
        east = 0.05 * SPEED * number
        longitude = 8.4 + np.degrees(east / (6378137 * np.cos(np.radians(49.0))))
        numbers = [49.0, longitude, 116.0, 0, 0, 0, *[0] * 24]
        text = " ".join(f"{number:.14g}" for number in numbers)
        (folder / f"oxts/data/{number:010d}.txt").write_text(text)
    for number in range(N):
        make_scan(number).tofile(folder / f"velodyne_points/data/{number:010d}.bin")
    for sensor, step in (("image_02", 0.05), ("oxts", 0.05), ("velodyne_points", 0.1)):
        stamps = [date.format(25 + step * number) for number in range(2 * N)]
        (folder / sensor / "timestamps.txt").write_text("".join(stamps))
    day = folder.parent
    (day / "calib_cam_to_cam.txt").write_text(
        "S_rect_02: 64 48\nR_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_02: 60 0 32 0 0 60 24 0 0 0 1 0\n"
    )
    (day / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.3 -0.5\n")
    (day / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n")
    return folder


def test_a_drive_is_moved_by_its_oxts(drive, run, make_scan):
    answers = run(drive, "--max-skew-ms", 20)
    assert answers.exit_code == 0, answers.text
    assert answers.column("degraded") == ["", "depth_reused"] * N
    expected = projected(make_scan(2), 0.05 * SPEED)
    assert agree(answers.fed_depth(f"{5:010d}"), np.round(expected * 256) / 256)
    assert answers.report["inputs"]["poses"] == str(drive / "oxts")


@pytest.mark.parametrize(("missing", "note"), [
    ("../calib_imu_to_velo.txt", "calib_imu_to_velo.txt is missing"),
    ("oxts/timestamps.txt", "oxts/timestamps.txt is missing"),
])  # fmt: skip
def test_a_drive_says_why_its_poses_are_not_used(drive, missing, note):
    (drive / missing).unlink()
    source = KittiRawSource(drive, max_skew_ms=20)
    frame = source.read(source.list_frames()[1])
    assert frame.degraded == ("depth_reused", "depth_uncompensated")
    assert any(note in line for line in source.notes)


def test_a_transform_of_the_imu_that_is_not_rigid_is_an_error(drive):
    (drive / "../calib_imu_to_velo.txt").write_text("R: 2 0 0 0 2 0 0 0 2\nT: 0 0 0\n")
    with pytest.raises(InputError, match=r"calib_imu_to_velo\.txt"):
        KittiRawSource(drive)


# --- bags ----------------------------------------------------------------------------------------


def fill(bag, make_frame, make_scan):
    for index in range(2 * N):
        rgb, _ = make_frame(*SIZE, seed=index)
        bag.image("/cam/image_rect", rgb, "rgb8", START_NS + 50 * MS * index)
    bag.info("/cam/camera_info", INTRINSICS, SIZE)
    for index in range(N):
        bag.cloud("/lidar/points", make_scan(index), START_NS + 100 * MS * index)
    add_tree(bag)


def add_poses(bag, *, kind="odometry", child="base", fixed="odom"):
    for step in range(80):
        stamp_ns, ahead = START_NS + (10 * step - 50) * MS, SPEED * (0.01 * step - 0.05)
        if kind == "odometry":
            bag.odometry("/odom", (ahead, 0.0, 0.0), stamp_ns, child=child)
        else:
            bag.transform(fixed, child, (0.0, 0.0, 0.0, 1.0), (ahead, 0.0, 0.0), stamp_ns)
            bag.transform("map", "odom", (0.0, 0.0, 0.0, 1.0), (5.0, 0.0, 0.0), stamp_ns)


@pytest.mark.parametrize("kind", ["odometry", "tf"])
@pytest.mark.parametrize("of", ["ros1", "mcap"])
def test_a_bag_is_moved_by_its_own_poses(make_bag, make_frame, make_scan, run, kind, of):
    bag = make_bag(of)
    fill(bag, make_frame, make_scan)
    add_poses(bag, kind=kind)
    answers = run(bag.write(), "--max-skew-ms", 20)
    assert answers.exit_code == 0, answers.text
    assert answers.column("degraded") == ["", "depth_reused"] * N
    for index in (1, 2, 3):
        expected = projected(make_scan(index // 2), 0.05 * SPEED * (index % 2))
        name = str(START_NS + 50 * MS * index)
        assert agree(answers.fed_depth(name), np.round(expected * 256) / 256)
    topic = {"odometry": "/odom", "tf": "/tf"}[kind]
    assert answers.report["inputs"]["pose_topic"] == topic
    assert f"pose_topic={topic}" in answers.text


def test_clouds_with_a_time_for_each_point_are_deskewed(make_bag, make_frame, make_scan):
    bag = make_bag("mcap")
    fill(bag, make_frame, make_scan)
    add_poses(bag)
    after_s = np.linspace(0, 0.1, 300, dtype=np.float32)
    scan = make_scan(7)
    records = np.column_stack([scan[:, :3], after_s]).astype(np.float32)
    bag.messages = [each for each in bag.messages if each[0] != "/lidar/points"]
    fields = [bag.field(name, 4 * place) for place, name in enumerate(("x", "y", "z", "time"))]
    more = {"fields": fields, "point_step": 16, "row_step": 16 * 300}
    data = records.reshape(-1).view(np.uint8)
    bag.cloud("/lidar/points", scan, START_NS + 100 * MS, data=data, **more)
    with BagSource(bag.write(), max_skew_ms=20) as source:
        frame = source.read(source.list_frames()[3])
    assert (frame.depth_motion, frame.reused) == ("each", True)
    scan[:, 0] += SPEED * after_s
    assert agree(frame.sparse_depth, projected(scan, 0.05 * SPEED))


@pytest.mark.parametrize(("poses", "note"), [
    ({"child": "elsewhere"}, "/tf_static does not connect the frame 'lidar' to 'elsewhere'"),
    ({"kind": "tf", "child": "elsewhere"}, "/tf moves none of the frames lidar, base"),
    ({"kind": "tf", "fixed": "footprint"}, "'footprint', which moves itself in 'odom'"),
])  # fmt: skip
def test_a_bag_says_why_its_poses_are_not_used(make_bag, make_frame, make_scan, poses, note):
    bag = make_bag("mcap")
    fill(bag, make_frame, make_scan)
    add_poses(bag, **poses)
    bag.transform("odom", "footprint", (0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0), START_NS)
    path = bag.write()
    with BagSource(path, max_skew_ms=20) as source:
        frame = source.read(source.list_frames()[1])
        assert frame.degraded == ("depth_reused", "depth_uncompensated")
        assert any(note in line for line in source.notes), source.notes
    topic = "/tf" if poses.get("kind") == "tf" else "/odom"
    with pytest.raises(InputError, match=note.partition(" the frame")[0]):
        BagSource(path, pose_topic=topic)
    with BagSource(path, pose_topic="none") as source:
        assert source.notes[0].startswith("topics")


def test_one_of_several_topics_of_odometry_is_chosen(make_bag, make_frame, make_scan):
    bag = make_bag("mcap")
    fill(bag, make_frame, make_scan)
    add_poses(bag)
    bag.odometry("/gps/odom", (0.0, 0.0, 0.0), START_NS)
    path = bag.write()
    with BagSource(path) as source:
        assert any("/gps/odom, /odom by pose_topic=" in note for note in source.notes)
        assert source.inputs["pose_topic"] is None
    with BagSource(path, pose_topic="/odom") as source:
        assert source.inputs["pose_topic"] == "/odom"
    with pytest.raises(InputError, match="pose_topic=/imu"):
        BagSource(path, pose_topic="/imu")


def test_a_depth_map_is_reused_as_it_is_and_flagged(folders, write_depth, make_frame):
    for number in range(0, 2 * N, 2):
        write_depth(folders / f"depth/{number}.png", make_frame(*SIZE, seed=number)[1])
    source = FolderSource(folders / "image", depth=folders / "depth", reuse_depth_ms=150)
    frames = source.list_frames()
    assert "guessed: the images are 100 ms apart; timestamps= in --source says when" in source.notes
    own, reused = (source.read(frame) for frame in frames[:2])
    assert own.degraded == ()
    assert (reused.degraded, reused.depth_motion) == (
        ("depth_reused", "depth_uncompensated"),
        "none",
    )
    assert np.array_equal(own.sparse_depth, reused.sparse_depth)
