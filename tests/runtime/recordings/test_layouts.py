"""Recordings as people download them: what a path without any option is read as."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from runtime import InputError
from runtime.app.tools.verify import app as verify_app
from runtime.geometry.rig import Rig
from runtime.recordings.layouts import KittiObjectSource
from runtime.recordings.registry import detect_source, open_source
from runtime.verification.reference import read_reference
from small_rig import SIZE, projected

N = 3
IMAGE, DEPTH, SCAN = "an image", "a depth map", "a scan"
PROJECTION = "60 0 32 0 0 60 24 0 0 0 1 0"


def calibration(focal_px, *, right_px=0.0):
    """The calibration is like KITTI's object data; camera 3 is to the right of camera 2."""
    shifts = {2: 0, 3: right_px}
    rows = [f"P{n}: {focal_px} 0 32 {x} 0 {focal_px} 24 0 0 0 1 0" for n, x in shifts.items()]
    to_camera = "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 -0.3 1 0 0 0"
    return "\n".join([*rows, "R0_rect: 1 0 0 0 1 0 0 0 1", to_camera, "", ""])


OBJECT = calibration(60)
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

# (kind, what the files hold); a name with a place for a number is several files.
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


def test_folders_that_are_neither_the_images_nor_the_depth_are_reported(write, make_frame):
    others = {"lidar/{}.bin": SCAN, "image_thermal/{}.png": IMAGE, "depth_confidence/{}.png": DEPTH}
    with open_path(write({"image/{}.png": IMAGE, "depth/{}.png": DEPTH, **others})) as source:
        depth = source.read(source.list_frames()[0]).sparse_depth
        assert abs(depth - make_frame(*SIZE, seed=0)[1]).max() < 0.01
        for name in others:
            assert any(f"{name.partition('/')[0]}/ is not read" in note for note in source.notes)


def test_several_folders_of_images_are_an_error(write):
    files = {"image_02/{}.png": IMAGE, "image_03/{}.png": IMAGE, "depth/{}.png": DEPTH}
    with pytest.raises(InputError, match="image_02, image_03, depth"):
        open_path(write(files))


def test_scans_beside_images_need_a_calibration(write):
    folder = write({"{}.jpg": IMAGE, "{}.pcd.bin": SCAN, "../given.toml": TOML})
    with pytest.raises(InputError, match="calibration="):
        open_path(folder)
    with open_source("one-folder", folder, Rig(calibration=folder / "../given.toml")) as source:
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


# --- KITTI's object data -------------------------------------------------------------------------


@pytest.fixture
def training(write):
    """Frames of both cameras, with focal lengths of 60 to 62 px."""
    files = {"image_2/{:06d}.png": IMAGE, "image_3/{:06d}.png": IMAGE, "calib/{:06d}.txt": ""}
    folder = write({**files, "velodyne/{:06d}.bin": SCAN})
    for number in range(N):
        (folder / f"calib/{number:06d}.txt").write_text(calibration(60 + number, right_px=-30.5))
    return folder


@pytest.mark.parametrize(("given", "focal_px"), [([], None), (["--focal-length", 200], 200)])
def test_each_frame_is_predicted_with_its_focal_length(
    training, run, model_file, contract, make_scan, tmp_path, given, focal_px
):
    """The graph adds 1.5 m of a camera of 100 px, which are 1.5 m times f / 100 of any other."""
    canonical = dataclasses.replace(contract, canonical_focal_px=100.0, max_depth_m=400.0)
    model = model_file(contract=canonical, heads=("semantic", "depth"))
    answers = run(training, "--model", model, "--record", tmp_path / "recorded", *given)
    assert answers.exit_code == 0, answers.text
    for number in range(N):
        focal = focal_px or 60 + number
        expected = projected(make_scan(number), focal_px=60 + number) + 1.5 * focal / 100
        assert abs(answers.fed_depth(f"{number:06d}") + 1.5 - expected).max() < 0.01
    recorded = read_reference(tmp_path / "recorded").frames
    assert [each.focal_length_px for each in recorded] == [focal_px or 60 + n for n in range(N)]
    done = CliRunner().invoke(verify_app, [str(tmp_path / "recorded")])
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("kind", ["kitti-object", "folders", "one-folder"])
def test_the_right_camera_has_its_own_projection(training, kind, make_scan):
    path, rig, options = training, Rig(), {"camera": 3}
    if kind != "kitti-object":
        rig, options = Rig(calibration=training / "calib"), {"points": training / "velodyne"}
        path = training / "image_3"
    with open_source(kind, path, rig, **options) as source:
        expected = projected(make_scan(1), focal_px=61, left_m=-0.5)
        depth = source.read(source.list_frames()[1]).sparse_depth
        assert abs(depth - expected).max() < 0.01


def test_an_image_without_its_scan_is_the_camera_alone(training):
    (training / "velodyne/000001.bin").unlink()
    (training / "image_2/000002.png").unlink()
    source = KittiObjectSource(training)
    frames = source.list_frames()
    assert [each.name for each in frames] == ["000000", "000001"]
    assert [source.read(each).sparse_depth.any() for each in frames] == [True, False]
    assert source.inputs["left_out"] == {"depth: no_image": 1}
    assert "left out: depth: no_image 1" in source.notes
    (training / "velodyne").rename(training / "scans")
    source = KittiObjectSource(training)
    assert [each.complete for each in source.list_frames()] == [True, True]
    assert any("no velodyne folder" in note for note in source.notes)


def test_what_is_missing_costs_its_frame(training):
    with pytest.raises(InputError, match="camera="):
        KittiObjectSource(training, camera=1)
    (training / "calib/000000.txt").write_text("P2: nan\n")
    (training / "calib/000002.txt").unlink()
    source = KittiObjectSource(training)
    frames = source.list_frames()
    for index, named in ((0, "'P2'"), (2, "000002 has no calibration")):
        with pytest.raises(InputError, match=named):
            source.read(frames[index])
    assert source.calibration.focal_length_px == source.read(frames[1]).calibration.focal_length_px


DATA = os.environ.get("SSDNET_DATA")


@pytest.mark.skipif(not DATA, reason="SSDNET_DATA names no folder of recordings")
def test_recorded_frames_have_returns_where_there_are_scans():
    folder = Path(DATA) / "kitti_object"
    with KittiObjectSource(folder, points=folder / "velodyne_fov") as source:
        frames = [source.read(listed) for listed in source.list_frames()]
    returns = {frame.name: np.count_nonzero(frame.sparse_depth) for frame in frames}
    assert len(frames) == 18
    with_scan = {name: count for name, count in returns.items() if count}
    assert list(with_scan) == [f"{number:06d}" for number in (4, 5, 6, 7, 9)]
    assert min(with_scan.values()) > 15_000
    assert len({frame.calibration.focal_length_px for frame in frames}) > 1
