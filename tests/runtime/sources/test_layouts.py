"""Recordings as people download them: what a path without any option is read as."""

import numpy as np
import pytest
from small_rig import SIZE, projected

from runtime import InputError
from runtime.sources.folders import FolderSource
from runtime.sources.registry import detect_source, open_source

N = 3
IMAGE, DEPTH, SCAN = "an image", "a depth map", "a scan"
PROJECTION = "60 0 32 0 0 60 24 0 0 0 1 0"
TO_CAMERA = "0 -1 0 0 0 0 -1 -0.3 1 0 0 0"
OBJECT = f"P2: {PROJECTION}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {TO_CAMERA}\n"
RAW = {
    "../calib_cam_to_cam.txt": f"S_rect_02: 64 48\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
    f"P_rect_02: {PROJECTION}\n",
    "../calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.3 0\n",
}
STAMPS = "".join(f"2011-09-26 13:02:25.{number}00000000\n" for number in range(N))
TOML = """intrinsics = [[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]
extrinsics = [[0, -1.0, 0, 0], [0, 0, -1, -0.3], [1, 0, 0, 0], [0, 0, 0, 1]]
"""
OF_DEPTH = "2011_09_26_drive_0002_sync_{}_{{:010d}}_image_02"

#: (kind, what the files hold); a name with a place for a number is several files.
LAYOUTS = [
    ("kitti-raw", {
        **dict.fromkeys(["image_02/data/{:010d}.png", "image_03/data/{:010d}.png"], IMAGE),
        "velodyne_points/data/{:010d}.bin": SCAN, "oxts/data/{:010d}.txt": "49.0 8.4 116",
        "image_02/timestamps.txt": STAMPS, "velodyne_points/timestamps.txt": STAMPS, **RAW,
    }),
    ("one-folder", {"image_02/{:010d}.png": IMAGE, "velodyne_points/{:010d}.bin": SCAN, **RAW}),
    ("kitti-object", {
        "image_2/{:06d}.png": IMAGE, "image_3/{:06d}.png": IMAGE, "velodyne/{:06d}.bin": SCAN,
        "calib/{:06d}.txt": OBJECT, "label_2/{:06d}.txt": "Car 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n",
    }),
    ("kitti-object", {  # View of Delft
        "image_2/{:05d}.jpg": IMAGE, "velodyne/{:05d}.bin": SCAN, "pose/{:05d}.json": "{}",
        "calib/{:05d}.txt": f"P0:\nP1:\n{OBJECT}Tr_imu_to_velo:\n",
        "../../radar/training/velodyne/{:05d}.bin": SCAN,
    }),
    ("one-folder", {  # KITTI's depth selection
        f"image/{OF_DEPTH.format('image')}.png": IMAGE,
        f"velodyne_raw/{OF_DEPTH.format('velodyne_raw')}.png": DEPTH,
        f"groundtruth_depth/{OF_DEPTH.format('groundtruth_depth')}.png": DEPTH,
        f"intrinsics/{OF_DEPTH.format('image')}.txt": "60 0 32 0 60 24 0 0 1 \n",
    }),
    *(("one-folder", {image: IMAGE, depth: DEPTH}) for image, depth in [
        ("image/{}.png", "depth/{}.png"), ("rgb/{}.png", "depth/{}.png"),
        ("Color/{}.png", "sparse_depth_02/{}.png"), ("{:04d}.jpg", "{:04d}.png"),
        ("images/left_{}.png", "depth/depth_{}.png"), ("rgb_{}.png", "depth_{}.png"),
        ("{}_image.png", "{}_depth.png"), ("{}.png", "{}_depth.png"),
        ("image/rgb_{}.png", "depth/{}.png"), ("rgb_{}.jpg", "depth_{}.png"),
    ]),
    ("one-folder", {"{}.jpg": IMAGE, "{}.pcd.bin": SCAN, "calib.toml": TOML}),  # of nuScenes
]  # fmt: skip


@pytest.fixture
def write(tmp_path, make_frame, make_scan, write_rgb, write_depth):
    """Write files by their names and what they hold; the folder."""

    def write_files(files):
        folder = tmp_path / "recording/training"
        for name, content in files.items():
            for number in range(N if "{" in name else 1):
                path = folder / name.format(number)
                path.parent.mkdir(parents=True, exist_ok=True)
                rgb, depth = make_frame(*SIZE, seed=number)
                if content is IMAGE:
                    write_rgb(path, rgb)
                elif content is DEPTH:
                    write_depth(path, depth)
                elif content is SCAN:
                    columns = 5 if path.name.endswith(".pcd.bin") else 4
                    np.resize(make_scan(number).T, (columns, 300)).T.tofile(path)
                else:
                    path.write_text(content)
        return folder

    return write_files


def open_path(path):
    return open_source(*detect_source(path)[:2])


@pytest.mark.parametrize(("kind", "files"), LAYOUTS)
def test_a_folder_is_read_as_it_is(write, make_frame, make_scan, kind, files):
    folder = write(files)
    assert detect_source(folder)[:2] == (kind, folder)
    with open_path(folder) as source:
        frames = source.list_frames()
        assert [each.complete for each in frames] == [True] * N
        for number, listed in enumerate(frames):
            depth, scan = make_frame(*SIZE, seed=number)[1], make_scan(number)
            expected = projected(scan) if SCAN in files.values() else depth
            assert np.count_nonzero(expected) > 100
            assert abs(source.read(listed).sparse_depth - expected).max() < 0.01
        has_calibration = set(files.values()) - {IMAGE, DEPTH, SCAN}
        assert bool(has_calibration) == (source.calibration is not None)
        assert not has_calibration or source.calibration.focal_length_px == 60


def test_a_folder_from_end_to_end(write, run, make_frame):
    answers = run(write({"images/left_{}.png": IMAGE, "depth/depth_{}.png": DEPTH}))
    assert (answers.exit_code, answers.column("degraded")) == (0, [""] * N), answers.text
    assert answers.names == ["left_0", "left_1", "left_2"]
    assert abs(answers.fed_depth("left_2") - make_frame(*SIZE, seed=2)[1]).max() < 0.01
    assert "pairs by the numbers in their names, as left_0.png with depth_0.png" in answers.text


def test_numbers_that_two_depth_maps_have_are_no_pair(write):
    folder = write({"image/left_{}.png": IMAGE, "depth/depth_{}.png": DEPTH})
    (folder / "depth/other_1.png").touch()
    with pytest.raises(InputError, match="no name occurs in both"):
        open_path(folder).list_frames()


def test_scans_beside_depth_maps_are_reported_as_not_read(write, make_frame):
    scans = {"lidar/{}.bin": SCAN, "velodyne/{}.bin": SCAN}
    with open_path(write({"image/{}.png": IMAGE, "depth/{}.png": DEPTH, **scans})) as source:
        depth = source.read(source.list_frames()[0]).sparse_depth
        assert abs(depth - make_frame(*SIZE, seed=0)[1]).max() < 0.01
        for name in ("lidar", "velodyne"):
            assert any(f"{name}/ is not the depth, nor read" in note for note in source.notes)


def test_scans_beside_images_need_a_calibration(write):
    folder = write({"{}.jpg": IMAGE, "{}.pcd.bin": SCAN, "../given.toml": TOML})
    with pytest.raises(InputError, match="--calibration"):
        open_path(folder)
    with open_source("one-folder", folder, calibration=folder / "../given.toml") as source:
        assert np.count_nonzero(source.read(source.list_frames()[0]).sparse_depth) > 100


@pytest.mark.parametrize(("folder", "is_scan"), [("points", True), ("depth", False)])
def test_arrays_are_what_their_folder_says(write, make_frame, make_scan, folder, is_scan):
    data = write({"image/0.png": IMAGE, "calib.toml": TOML})
    (data / folder).mkdir()
    np.save(data / folder / "0.npy", make_scan() if is_scan else make_frame()[1])
    with open_path(data) as source:
        depth = source.read(source.list_frames()[0]).sparse_depth
        np.testing.assert_allclose(
            depth, projected(make_scan()) if is_scan else make_frame()[1], atol=0.01
        )


def test_a_folder_of_calibrations_has_one_a_frame(write):
    folder = write({"image/{}.png": IMAGE, "points/{}.bin": SCAN, "../calib/{}.toml": TOML})
    calib = folder.parent / "calib"
    (calib / "1.toml").write_text(TOML.replace("60", "50"))
    (calib / "2.toml").unlink()
    source = FolderSource(folder / "image", points=folder / "points", calibration=calib)
    frames = source.list_frames()
    assert [source.read(each).calibration.focal_length_px for each in frames[:2]] == [60, 50]
    assert source.calibration.focal_length_px == 60
    with pytest.raises(InputError, match="2 has no calibration"):
        source.read(frames[2])
