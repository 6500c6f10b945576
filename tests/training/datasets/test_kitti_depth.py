"""KITTI's depth completion benchmark on small files in its real layouts."""

from functools import partial

import numpy as np
import pytest

from layouts import open_set
from layouts.kitti_depth import DATE, DRIVE, NUMBERS, write_drive, write_selection
from runtime.base.errors import DatasetError

KittiDepth = partial(open_set, "kitti-depth")


def assert_depth_is_of_both_maps(sample):
    assert sample.returns.dtype == sample.depth.dtype == np.float32
    assert np.count_nonzero(sample.returns) == 1
    assert sample.returns[2, 3] == 10.25
    assert np.count_nonzero(sample.depth) == 2
    assert sample.depth[2, 3] == 1 / 256
    assert sample.depth[4, 7] == 65534 / 256
    assert sample.scan_line is None
    assert (sample.semantic == 255).all()


def test_drives_pair_images_with_both_maps(tmp_path):
    write_drive(tmp_path)
    source = KittiDepth(tmp_path, cameras=(2, 3))
    assert [source[index].name for index in range(len(source))] == [
        f"{DRIVE}/{camera}/{number}" for camera in (2, 3) for number in NUMBERS
    ]
    left, right = source[0], source[3]
    assert_depth_is_of_both_maps(left)
    assert (left.rgb == (100, 20, 40)).all()
    assert (right.rgb == (200, 20, 40)).all()


def test_intrinsics_are_those_of_the_raw_data_where_it_is_there(tmp_path):
    write_drive(tmp_path)
    left, right = (KittiDepth(tmp_path, cameras=(camera,))[0] for camera in (2, 3))
    assert left.intrinsics.tolist() == [[721.5, 0, 609.5], [0, 722.5, 172.8], [0, 0, 1]]
    assert right.intrinsics.tolist() == [[731.5, 0, 619.5], [0, 732.5, 182.8], [0, 0, 1]]
    (tmp_path / "raw" / DATE / "calib_cam_to_cam.txt").unlink()
    assert KittiDepth(tmp_path)[0].intrinsics is None


def test_selection_has_images_and_intrinsics_of_its_own(tmp_path):
    write_selection(tmp_path)
    source = KittiDepth(tmp_path, split="selection")
    first, second = (source[index] for index in range(2))
    assert first.name == f"{DATE}_drive_0002_sync_image_0000000005_image_02"
    assert_depth_is_of_both_maps(first)
    assert (first.rgb == (200, 20, 40)).all()
    assert first.intrinsics.tolist() == [[721.5, 0, 596.5], [0, 722.5, 149.82], [0, 0, 1]]
    assert second.intrinsics[1, 2] == 149.83


@pytest.mark.parametrize(("kind", "file"), [
    ("velodyne_raw", "velodyne_raw_0000000005_image_02.png"),
    ("groundtruth_depth", "groundtruth_depth_0000000005_image_02.png"),
    ("intrinsics", "image_0000000005_image_02.txt"),
])  # fmt: skip
def test_missing_parts_of_the_selection_are_named(tmp_path, kind, file):
    write_selection(tmp_path)
    path = tmp_path / "val_selection_cropped" / kind / f"{DATE}_drive_0002_sync_{file}"
    content = path.read_bytes()
    path.unlink()
    with pytest.raises(DatasetError, match=path.name):
        KittiDepth(tmp_path, split="selection")
    path.write_bytes(content[:-3])
    with pytest.raises(DatasetError, match=path.name):
        KittiDepth(tmp_path, split="selection")[0]
    # Depth maps without an image are no frame.
    (path.parents[1] / "image" / f"{DATE}_drive_0002_sync_image_0000000005_image_02.png").unlink()
    assert len(KittiDepth(tmp_path, split="selection")) == 1
