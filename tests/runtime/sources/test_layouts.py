"""Recordings as people download them: `ssdnet-run PATH` without any other option."""

import numpy as np
import pytest

N, SIZE = 3, (48, 64)
PROJECTION = "60 0 32 0 0 60 24 0 0 0 1 0"
OBJECT = (
    f"P2: {PROJECTION}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
)


@pytest.fixture
def layout(tmp_path, make_frame, make_scan, write_rgb, write_depth):
    """Write files by their paths; "{}" is a number."""

    class Layout:
        folder = tmp_path / "recording"

        def images(self, path):
            for number in range(N):
                write_rgb(self.folder / path.format(number), make_frame(*SIZE, seed=number)[0])

        def depths(self, path):
            for number in range(N):
                write_depth(self.folder / path.format(number), make_frame(*SIZE, seed=number)[1])

        def scans(self, path):
            for number in range(N):
                target = self.folder / path.format(number)
                target.parent.mkdir(parents=True, exist_ok=True)
                make_scan(number).tofile(target)

        def texts(self, path, text):
            for number in range(N if "{" in path else 1):
                target = self.folder / path.format(number)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(text)

    return Layout()


def calibrate_raw(layout, folder):
    cameras = f"S_rect_02: 64 48\nR_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_02: {PROJECTION}\n"
    layout.texts(f"{folder}calib_cam_to_cam.txt", cameras)
    layout.texts(f"{folder}calib_velo_to_cam.txt", "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n")


def kitti_raw(layout):
    drive = "2011_09_26/2011_09_26_drive_0001_sync"
    calibrate_raw(layout, "2011_09_26/")
    layout.images(f"{drive}/image_02/data/{{:010d}}.png")
    layout.images(f"{drive}/image_03/data/{{:010d}}.png")
    layout.scans(f"{drive}/velodyne_points/data/{{:010d}}.bin")
    layout.texts(f"{drive}/oxts/data/{{:010d}}.txt", "49.0 8.4 116")
    for sensor in ("image_02", "image_03", "velodyne_points"):
        stamps = "".join(f"2011-09-26 13:02:25.{number}00000000\n" for number in range(N))
        layout.texts(f"{drive}/{sensor}/timestamps.txt", stamps)
    return layout.folder / drive


def kitti_raw_without_data(layout):
    calibrate_raw(layout, "day/")
    layout.images("day/drive/image_02/{:010d}.png")
    layout.scans("day/drive/velodyne_points/{:010d}.bin")
    return layout.folder / "day/drive"


def kitti_object(layout):
    layout.images("image_2/{:06d}.png")
    layout.images("image_3/{:06d}.png")
    layout.scans("velodyne/{:06d}.bin")
    layout.texts("calib/{:06d}.txt", OBJECT)
    layout.texts("label_2/{:06d}.txt", "Car 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n")
    return layout.folder


def view_of_delft(layout):
    layout.images("lidar/training/image_2/{:05d}.jpg")
    layout.scans("lidar/training/velodyne/{:05d}.bin")
    layout.texts("lidar/training/calib/{:05d}.txt", f"P0:\nP1:\n{OBJECT}Tr_imu_to_velo:\n")
    layout.texts("lidar/training/pose/{:05d}.json", "{}")
    layout.texts("lidar/training/label_2/{:05d}.txt", "Car 0 0 0 0 0 0 0 0 0 0 0 0 0 0 1\n")
    layout.scans("radar/training/velodyne/{:05d}.bin")
    return layout.folder / "lidar/training"


def kitti_depth_selection(layout):
    drive = "2011_09_26_drive_0002_sync"
    layout.images(f"image/{drive}_image_{{:010d}}_image_02.png")
    layout.depths(f"velodyne_raw/{drive}_velodyne_raw_{{:010d}}_image_02.png")
    layout.depths(f"groundtruth_depth/{drive}_groundtruth_depth_{{:010d}}_image_02.png")
    layout.texts(f"intrinsics/{drive}_image_{{:010d}}_image_02.txt", "60 0 32 0 60 24 0 0 1 \n")
    return layout.folder


def pictures_and_depth_folders(layout):
    layout.images("images/{}.png")
    layout.depths("depth/{}.png")
    return layout.folder


def pictures_with_depth_beside(layout):
    layout.images("{:04d}.jpg")
    layout.depths("{:04d}.png")
    return layout.folder


@pytest.mark.parametrize(
    ("make", "kind", "focal_px"),
    [
        (kitti_raw, "kitti-raw", 60),
        (kitti_raw_without_data, "one-folder", 60),
        (kitti_object, "kitti-object", 60),
        (view_of_delft, "kitti-object", 60),
        (kitti_depth_selection, "one-folder", 60),
        (pictures_and_depth_folders, "one-folder", None),
        (pictures_with_depth_beside, "one-folder", None),
    ],
)
def test_a_folder_runs_as_it_is(layout, run, make, kind, focal_px, make_frame, make_scan):
    path = make(layout)
    answers = run(path)
    assert answers.exit_code == 0, answers.text
    assert answers.column("status") == ["ok"] * N
    assert answers.column("degraded") == [""] * N
    assert answers.report["inputs"]["source"] == f"{kind}:{path}"
    assert answers.report["inputs"]["focal_length_px"] == focal_px
    for number, name in enumerate(answers.names):
        if focal_px is None or make is kitti_depth_selection:
            expected = make_frame(*SIZE, seed=number)[1]
        else:
            x, y, z, _ = make_scan(number).astype(np.float64).T
            expected = np.full(SIZE, np.inf)
            row, column = (
                np.rint(-60 * z / x + 24).astype(int),
                np.rint(-60 * y / x + 32).astype(int),
            )
            inside = (row >= 0) & (row < SIZE[0]) & (column >= 0) & (column < SIZE[1])
            np.minimum.at(expected, (row[inside], column[inside]), x[inside])
            expected[np.isinf(expected)] = 0
        assert np.count_nonzero(expected) > 100
        assert abs(answers.fed_depth(name) - expected).max() < 0.01
