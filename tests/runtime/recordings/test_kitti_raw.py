"""A drive of KITTI raw data."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.recordings.images import read_sparse_depth
from runtime.recordings.kitti_raw import KittiRawSource
from small_rig import SIZE, SPEED, BackwardsOdometry, agree, projected

CAMERAS = """calib_time: 09-Jan-2012 13:57:47
S_rect_02: 64 48
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: 60 0 32 3 0 60 24 0 0 0 1 0
S_rect_03: 64 48
P_rect_03: 60 0 32 -30 0 60 24 0 0 0 1 0
"""
SCANNER = """calib_time: 15-Mar-2012 11:37:16
R: 0 -1 0 0 0 -1 1 0 0
T: 0 -0.3 0
"""


def stamps(milliseconds):
    return "".join(
        f"2011-09-26 13:02:{25 + ms // 1000:02d}.{ms % 1000:03d}000123\n" for ms in milliseconds
    )


@pytest.fixture
def drive(tmp_path, make_frame, make_scan, write_rgb):
    """Six numbered images at 10 Hz, each with a scan 13 ms earlier; both cameras the same."""
    folder = tmp_path / "2011_09_26/2011_09_26_drive_0001_sync"
    (folder / "velodyne_points/data").mkdir(parents=True)
    for number in range(6):
        rgb, _ = make_frame(*SIZE, seed=number)
        for camera in (2, 3):
            write_rgb(folder / f"image_0{camera}/data/{number:010d}.png", rgb)
        make_scan(number).tofile(folder / f"velodyne_points/data/{number:010d}.bin")
    for camera in (2, 3):
        (folder / f"image_0{camera}/timestamps.txt").write_text(stamps(range(100, 700, 100)))
    (folder / "velodyne_points/timestamps.txt").write_text(stamps(range(87, 687, 100)))
    (folder.parent / "calib_cam_to_cam.txt").write_text(CAMERAS)
    (folder.parent / "calib_velo_to_cam.txt").write_text(SCANNER)
    return folder


def write_oxts(drive):
    """Write poses at 20 Hz; the car drives to the east, which is x."""
    (drive / "oxts/data").mkdir(parents=True)
    for number in range(14):
        longitude = 8.4 + np.degrees(0.05 * SPEED * number / (6378137 * np.cos(np.radians(49.0))))
        numbers = [49.0, longitude, 116.0, 0, 0, 0, *[0] * 24]
        text = " ".join(f"{number:.14g}" for number in numbers)
        (drive / f"oxts/data/{number:010d}.txt").write_text(text)
    (drive / "oxts/timestamps.txt").write_text(stamps(range(0, 700, 50)))
    (drive.parent / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n")


def test_a_drive_from_end_to_end(drive, run, make_scan):
    answers = run("--source", f"kitti-raw:{drive},camera=3")
    answers.require({f"{n:010d}": projected(make_scan(n), left_m=-0.5) for n in range(6)})
    images, scans = (
        np.int64(answers.column(f"{sensor}_stamp_ns")) for sensor in ("image", "depth")
    )
    assert images[0] == 1317042145_100000123, "2011-09-26 13:02:25.100000123 UTC"
    assert set(images - scans) == {13_000_000}
    inputs = answers.report["inputs"]
    assert inputs["source"] == f"kitti-raw:{drive}"
    assert (inputs["camera"], inputs["focal_length_px"]) == (3, 60)


def test_a_drive_that_is_not_rectified_has_the_lens(drive, make_scan):
    folder = drive.rename(drive.parent / "2011_09_26_drive_0001_extract")
    angles, shift = np.array([0.01, 0.02, 0]), [0.06, 0, 0.01]
    distortion = [-0.3, 0.1, 1e-3, -2e-3, 0]
    numbers = {"S": SIZE[::-1], "K": [70, 0, 31, 0, 71, 23, 0, 0, 1], "D": distortion, "T": shift}
    numbers["R"] = cv2.Rodrigues(angles)[0].ravel()
    rows = [f"{name}_02: {' '.join(map(str, row))}\n" for name, row in numbers.items()]
    (folder.parent / "calib_cam_to_cam.txt").write_text(CAMERAS + "".join(rows))
    source = KittiRawSource(folder)
    calibration = source.calibration
    assert (calibration.lens, calibration.size) == ("plumb_bob", SIZE)
    fed = source.read(source.list_frames(limit=1)[0]).sparse_depth
    np.testing.assert_array_equal(fed, calibration.project(make_scan(0), SIZE))
    assert np.count_nonzero(fed) > 100
    # By OpenCV: LiDAR, camera 0, camera 2, pixel.
    point = np.array([12.0, 1.5, -0.4], np.float32)
    first = np.array([[-point[1], -point[2] - 0.3, point[0]]])
    given = angles, np.array(shift), calibration.intrinsics, np.array(distortion)
    (found,) = np.argwhere(calibration.project(point[None], SIZE))
    np.testing.assert_allclose(found[::-1], cv2.projectPoints(first, *given)[0][0, 0], atol=0.5)


def test_stamps_decide_and_not_numbers(drive, make_scan):
    """The scanner started one turn later: its number 0 belongs to image 1."""
    (drive / "velodyne_points/timestamps.txt").write_text(stamps(range(187, 787, 100)))
    source = KittiRawSource(drive)
    frames = source.list_frames()
    depths = [frame.depth and int(frame.depth.stem) for frame in frames]
    assert depths == [None, 0, 1, 2, 3, 4]
    expected = projected(make_scan(0), left_m=0.05)
    assert abs(source.read(frames[1]).sparse_depth - expected).max() < 0.001


@pytest.mark.parametrize("sensor", ["image_02", "velodyne_points"])
def test_without_stamps_numbers_decide(drive, sensor):
    (drive / sensor / "timestamps.txt").unlink()
    (drive / "image_02/data/0000000001.png").unlink()
    (drive / "velodyne_points/data/0000000003.bin").unlink()
    source = KittiRawSource(drive)
    frames = source.list_frames()
    assert [int(each.name) for each in frames] == [0, 2, 3, 4, 5]
    assert [each.depth is None for each in frames] == [False, False, True, False, False]
    assert {each.image_stamp_ns for each in frames} == {None}
    assert source.inputs["left_out"] == {"depth: no_image": 1}


IMAGES, SCANS = "image_02", "velodyne_points"


@pytest.mark.parametrize(("path", "content", "named"), [
    (f"{IMAGES}/timestamps.txt", "yesterday\n" * 6, "line 1 of .*image_02/timestamps.txt"),
    (f"{IMAGES}/timestamps.txt", "2011-09-26 13:02:25.-1234567\n" * 6, "line 1 of "),
    (f"{SCANS}/timestamps.txt", stamps([87, 187]), "0000000005.bin"),
    ("../calib_velo_to_cam.txt", None, "calib_velo_to_cam.txt"),
    ("../calib_cam_to_cam.txt", None, "calibration="),
    (f"{IMAGES}/data", None, "camera="),
    (f"{IMAGES}/data/left.png", "", "left.png"),
    (f"{IMAGES}/data/00.png", "", "same number"),
])  # fmt: skip
def test_a_drive_that_is_not_whole(drive, path, content, named):
    if content is None:
        (drive / path).rename(drive / "elsewhere")
    else:
        (drive / path).write_text(content)
    with pytest.raises(InputError, match=named):
        KittiRawSource(drive).list_frames()


DATA = os.environ.get("SSDNET_DATA")


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
def test_a_real_drive_gives_the_depth_maps_that_were_made_of_it(tmp_path):
    """The recording holds the returns in view and their projection, by floor where ours rounds."""
    kitti = Path(DATA) / "kitti_stream"
    for link, target in (("image_02", "image_02"), ("velodyne_points", "velodyne_fov")):
        (tmp_path / "drive" / link).mkdir(parents=True)
        (tmp_path / "drive" / link / "data").symlink_to(kitti / target)
        (tmp_path / "drive" / link / "timestamps.txt").write_text(stamps(range(0, 6000, 100)))
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        (tmp_path / name).symlink_to(kitti / name)
    source = KittiRawSource(tmp_path / "drive")
    frames = source.list_frames()
    assert len(frames) == 60
    for frame in (frames[0], frames[41]):
        ours = source.read(frame).sparse_depth
        theirs = read_sparse_depth(kitti / "sparse_depth_02" / f"{frame.name}.png")
        both = (ours > 0) & (theirs > 0)
        assert abs(np.count_nonzero(ours) / np.count_nonzero(theirs) - 1) < 0.01
        assert np.median(abs(ours[both] - theirs[both])) < 0.01


def test_scans_of_another_time_match_no_image(drive, run):
    """As with stamps in local time, or of another drive."""
    (drive / "velodyne_points/timestamps.txt").write_text(stamps(range(20_000, 20_600, 100)))
    answers = run(drive)
    assert answers.exit_code == 3, answers.text
    assert "--max-skew-ms" in answers.report["frames"]["implausible_depth"]
    assert set(answers.column("degraded")) == {"no_depth"}


def test_a_drive_is_moved_by_its_oxts(drive, make_scan):
    write_oxts(drive)
    (drive / "velodyne_points/data/0000000003.bin").unlink()
    source = KittiRawSource(drive)
    frames = [source.read(listed) for listed in source.list_frames()]
    assert [each.degraded for each in frames] == [(), (), (), ("depth_reused",), (), ()]
    for number, scan, after_s in ((1, 1, 0.013), (3, 2, 0.113)):
        expected = projected(make_scan(scan), left_m=0.05, ahead_m=SPEED * after_s)
        assert agree(frames[number].sparse_depth, expected)
    assert source.inputs["poses"] == str(drive / "oxts")


@pytest.mark.parametrize("missing", ["../calib_imu_to_velo.txt", "oxts/timestamps.txt"])
def test_a_drive_says_why_its_poses_are_not_used(drive, make_scan, missing):
    write_oxts(drive)
    (drive / missing).unlink()
    source = KittiRawSource(drive)
    frame = source.read(source.list_frames()[1])
    assert agree(frame.sparse_depth, projected(make_scan(1), left_m=0.05))
    assert any(f"{Path(missing).name} is missing" in line for line in source.notes)


def test_odometry_replaces_the_poses_of_a_drive(drive, make_scan, monkeypatch):
    """The odometry drives backwards, `oxts` ahead."""
    write_oxts(drive)
    monkeypatch.setattr("runtime.recordings.folders.Odometry", BackwardsOdometry)
    source = KittiRawSource(drive, poses=Path("odometry"))
    frame = source.read(source.list_frames()[3])
    expected = projected(make_scan(3), left_m=0.05, ahead_m=-0.013 * SPEED)
    assert agree(frame.sparse_depth, expected)
    assert source.inputs["poses"] == "odometry"
    assert any("oxts, if any, are not used" in note for note in source.notes)
    with pytest.raises(InputError, match="holds its own poses"):
        KittiRawSource(drive, poses=Path("poses.txt"))
