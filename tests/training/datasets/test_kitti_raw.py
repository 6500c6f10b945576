"""KITTI raw data on small files in its real layout, with returns placed by hand."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.pictures import write
from runtime.errors import DatasetError
from training.datasets.kitti_raw import KittiRawRecipe
from training.loading.open_dataset import open_dataset

KittiRaw = partial(open_set, "kitti-raw")

DATE = "2011_09_26"
DRIVE = f"{DATE}_drive_0001_sync"
HEIGHT, WIDTH = 24, 48
#: A focal length of 10 px, the principal point at (24, 12), camera 3 two metres to the right.
CAM_TO_CAM = """\
calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
R_rect_00: 1 0 0 0 1 0 0 0 1
S_rect_02: 4.800000e+01 2.400000e+01
P_rect_02: 10 0 24 0 0 10 12 0 0 0 1 0
S_rect_03: 4.800000e+01 2.400000e+01
P_rect_03: 10 0 24 -20 0 10 12 0 0 0 1 0
"""
#: The camera sits half a metre before the LiDAR and looks along its x.
VELO_TO_CAM = """\
calib_time: 15-Mar-2012 11:37:16
R: 0 -1 0 0 0 -1 1 0 0
T: 0 0 -0.5
delta_f: 0 0
"""


def seen_at(u, v, depth):
    """The return that falls into the middle of pixel (u, v) of camera 2 at a depth."""
    return depth + 0.5, (24 - u) * depth / 10, (12 - v) * depth / 10, 0.3


def write_scan(path, points):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(np.array(points, "<f4").tobytes())


def write_frame(root, points, drive=DRIVE, number=0, cameras=(2, 3)):
    folder = root / DATE / drive
    for camera in cameras:
        image = np.full((HEIGHT, WIDTH, 3), (200, 20, 40 + camera), np.uint8)
        write(folder / f"image_{camera:02d}" / "data" / f"{number:010d}.png", image)
    write_scan(folder / "velodyne_points" / "data" / f"{number:010d}.bin", points)
    (root / DATE / "calib_cam_to_cam.txt").write_text(CAM_TO_CAM)
    (root / DATE / "calib_velo_to_cam.txt").write_text(VELO_TO_CAM)


#: Two lines, each from straight ahead to the left and round to the right. Left is a small azimuth.
UPPER = [seen_at(20, 5, 10.0), seen_at(10, 5, 12.0), seen_at(40, 5, 8.0), seen_at(30, 5, 20.0)]
LOWER = [seen_at(20, 9, 6.0), seen_at(10, 5, 11.0), seen_at(40, 5, 9.0)]


@pytest.fixture
def raw(tmp_path):
    write_frame(tmp_path, UPPER + LOWER)
    return tmp_path


def measured(array, none):
    return {(int(u), int(v)): array[v, u].item() for v, u in np.argwhere(array != none)}


def test_returns_fall_where_the_calibration_puts_them_and_the_nearest_wins(raw):
    sample = KittiRaw(raw)[0]
    assert sample.name == f"{DRIVE}/2/0000000000"
    assert sample.depth.dtype == np.float32
    assert measured(sample.depth, 0) == pytest.approx(
        {(20, 5): 10.0, (10, 5): 11.0, (40, 5): 8.0, (30, 5): 20.0, (20, 9): 6.0}
    )
    assert measured(sample.scan_line, -1) == {
        (20, 5): 0,
        (10, 5): 1,
        (40, 5): 0,
        (30, 5): 0,
        (20, 9): 1,
    }
    assert sample.sparse_depth is None
    assert (sample.rgb == (200, 20, 42)).all()
    assert (sample.semantic == 255).all()
    assert sample.intrinsics.tolist() == [[10, 0, 24], [0, 10, 12], [0, 0, 1]]


def test_the_right_camera_has_its_own_projection(raw):
    source = KittiRaw(raw, cameras=(2, 3))
    left, right = source[0], source[1]
    assert (len(source), right.name) == (2, f"{DRIVE}/3/0000000000")
    assert (right.rgb == (200, 20, 43)).all()
    # Two metres to the right move a return by 20 px m / depth: 2 px at 10 m, 3.33 px at 6 m.
    assert right.depth[5, 18] == pytest.approx(10.0)
    assert right.depth[9, 17] == pytest.approx(6.0)
    assert left.depth[5, 18] == right.depth[5, 20] == 0


def test_returns_hidden_behind_nearer_ones_can_be_withheld(tmp_path):
    # Hidden by the one at (20, 12) is what lies behind it up to 4 columns or 7 rows away.
    hidden = [seen_at(24, 12, 20.0), seen_at(16, 5, 20.0), seen_at(20, 19, 6.2)]
    visible = {
        (20, 12): 5.0,
        (20, 13): 6.0,  # a tenth and half a metre less are 4.9 m, no more than 5 m
        (15, 12): 20.0,
        (25, 12): 20.0,
        (20, 4): 20.0,
    }
    write_frame(tmp_path, hidden + [seen_at(*pixel, depth) for pixel, depth in visible.items()])
    assert np.count_nonzero(KittiRaw(tmp_path)[0].depth) == 8
    recipe = KittiRawRecipe(path=tmp_path.name, withhold_hidden=True)
    sample = open_dataset(recipe, [tmp_path.parent], classes="camvid")[0]
    assert measured(sample.depth, 0) == pytest.approx(visible)
    assert sample.sparse_depth is None
    assert ((sample.scan_line >= 0) == (sample.depth > 0)).all()


def test_drives_are_all_or_those_named(tmp_path):
    other = f"{DATE}_drive_0002_sync"
    for drive in (other, DRIVE):
        for number in (1, 0):
            write_frame(tmp_path, UPPER, drive, number)
    (tmp_path / DATE / f"{DATE}_drive_0001_tracklets.zip").touch()
    source = KittiRaw(tmp_path)
    assert [source[index].name for index in range(len(source))] == [
        f"{drive}/2/000000000{number}" for drive in (DRIVE, other) for number in (0, 1)
    ]
    assert [KittiRaw(tmp_path, drives=[other])[0].name] == [f"{other}/2/0000000000"]
    with pytest.raises(DatasetError, match=f"no drive {DATE}_drive_0009_sync; found 2 drives"):
        KittiRaw(tmp_path, drives=[other, f"{DATE}_drive_0009_sync"])
    recipe = KittiRawRecipe(path=tmp_path.name, drives=(other,), cameras=(3,))
    opened = open_dataset(recipe, [tmp_path.parent], classes="cityscapes")
    assert [len(opened), opened[0].name] == [2, f"{other}/3/0000000000"]


def test_the_four_images_published_without_a_scan_are_left_out(tmp_path):
    drive = f"{DATE}_drive_0009_sync"
    for number in (176, 177, 180, 181):
        write_frame(tmp_path, UPPER, drive, number)
    scans = tmp_path / DATE / drive / "velodyne_points" / "data"
    for number in (177, 180):
        (scans / f"{number:010d}.bin").unlink()
    source = KittiRaw(tmp_path)
    assert [source[index].name for index in range(len(source))] == [
        f"{drive}/2/0000000176",
        f"{drive}/2/0000000181",
    ]
    (scans / "0000000181.bin").unlink()
    with pytest.raises(DatasetError, match=r"data/0000000181\.bin: missing \(1 of 2"):
        KittiRaw(tmp_path)


@pytest.mark.parametrize(
    ("lost", "text"),
    [
        (f"{DATE}/{DRIVE}", "no drive <date>/<date>_drive_"),
        (f"{DATE}/{DRIVE}/image_02", "image_02/data is missing"),
        (
            f"{DATE}/{DRIVE}/velodyne_points/data/0000000000.bin",
            r"velodyne_points/data has no \.bin files",
        ),
        (f"{DATE}/calib_cam_to_cam.txt", r"cannot read .*calib_cam_to_cam\.txt"),
        (f"{DATE}/calib_velo_to_cam.txt", r"cannot read .*calib_velo_to_cam\.txt"),
    ],
)
def test_missing_parts_are_named(raw, lost, text):
    (raw / lost).rename(raw / "elsewhere")
    with pytest.raises(DatasetError, match=text):
        KittiRaw(raw)


def test_damaged_files_are_named(raw):
    scan = raw / DATE / DRIVE / "velodyne_points/data/0000000000.bin"
    scan.write_bytes(scan.read_bytes()[:-3])
    with pytest.raises(DatasetError, match=r"0000000000\.bin: its 109 bytes .*truncated"):
        KittiRaw(raw)[0]
    image = raw / DATE / DRIVE / "image_02/data/0000000000.png"
    image.write_bytes(image.read_bytes()[:-20])
    with pytest.raises(DatasetError, match=r"image_02/data/0000000000\.png is empty, truncated"):
        KittiRaw(raw)[0]
    write(image, np.zeros((HEIGHT, WIDTH + 1, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"0000000000\.png: its size 24x49 differs .*24x48"):
        KittiRaw(raw)[0]
