"""KITTI raw data on small files in its real layout, with returns placed by hand."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.kitti_raw import DATE, DRIVE, UPPER, write_frame
from runtime.base.errors import DatasetError

KittiRaw = partial(open_set, "kitti-raw")


@pytest.fixture
def raw(tmp_path):
    write_frame(tmp_path)
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
    assert sample.is_scan
    assert (sample.rgb == (200, 20, 42)).all()
    assert (sample.semantic == 255).all()
    assert sample.intrinsics.tolist() == [[10, 0, 24], [0, 10, 12], [0, 0, 1]]


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
    opened = KittiRaw(tmp_path, drives=[other], cameras=[3])
    assert [len(opened), opened[0].name] == [2, f"{other}/3/0000000000"]
    with pytest.raises(DatasetError, match=f"{DATE}_drive_0009_sync"):
        KittiRaw(tmp_path, drives=[other, f"{DATE}_drive_0009_sync"])


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
    with pytest.raises(DatasetError, match=r"data/0000000181\.bin"):
        KittiRaw(tmp_path)
