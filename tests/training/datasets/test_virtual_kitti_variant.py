"""The reader of a variant of a Virtual KITTI 2 scene."""

import os

import numpy as np
import pytest

from layouts.virtual_kitti import write_second_edition
from runtime import InputError
from training.datasets.virtual_kitti_variant import VirtualKittiVariant, read_depth

ROWS = "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n"


@pytest.fixture
def variant(tmp_path):
    """Four frames of both cameras."""
    return write_second_edition(tmp_path, frames=4, cameras=(0, 1))


@pytest.mark.parametrize("camera", [0, 1])
def test_each_camera_has_its_files_and_intrinsics(variant, camera):
    reader = VirtualKittiVariant(variant, camera=camera)
    frames = reader.list_frames()
    assert [frame.name for frame in frames] == ["00000", "00001", "00002", "00003"]
    for number, frame in enumerate(frames):
        assert frame.image == variant / f"frames/rgb/Camera_{camera}/rgb_{number:05d}.jpg"
        assert frame.depth == variant / f"frames/depth/Camera_{camera}/depth_{number:05d}.png"
        assert reader.calibrations[number].focal_length_px == 725 + number
        assert reader.calibrations[number].intrinsics[1, 2] == 180 + camera


def test_the_sky_has_no_depth_and_centimetres_become_metres(variant):
    frame = VirtualKittiVariant(variant).list_frames()[1]
    depth = read_depth(frame.depth)
    assert not depth[0].any()
    assert depth[1] == pytest.approx(655.34)
    np.testing.assert_allclose(depth[2:], 12.35)


def test_a_frame_that_lacks_its_partner_is_listed(variant):
    (variant / "frames/rgb/Camera_0/rgb_00001.jpg").unlink()
    (variant / "frames/depth/Camera_0/depth_00002.png").unlink()
    frames = VirtualKittiVariant(variant).list_frames()
    assert [frame.complete for frame in frames] == [True, False, False, True]
    assert frames[1].image is None
    assert frames[2].depth is None


@pytest.mark.parametrize("content", ["", ROWS, "0 1 70 70 32 24\n", "0 0 x 70 32 24\n"])
def test_intrinsics_without_the_camera_are_an_error(variant, content):
    (variant / "intrinsic.txt").write_text(content)
    with pytest.raises(InputError, match="has no row 'frame cameraID fx fy cx cy' of camera 0"):
        VirtualKittiVariant(variant)


def test_a_whole_scene_is_no_variant(variant):
    with pytest.raises(InputError, match="is not a variant of a Virtual KITTI 2 scene"):
        VirtualKittiVariant(variant.parent)


def test_folders_that_share_no_number_are_an_error(variant):
    for number in range(4):
        (variant / f"frames/rgb/Camera_0/rgb_{number:05d}.jpg").rename(
            variant / f"frames/rgb/Camera_0/rgb_{number + 4:05d}.jpg"
        )
    with pytest.raises(InputError, match="no number occurs both"):
        VirtualKittiVariant(variant).list_frames()


def test_a_pipe_in_place_of_the_intrinsics_is_not_waited_for(variant):
    (variant / "intrinsic.txt").unlink()
    os.mkfifo(variant / "intrinsic.txt")
    with pytest.raises(InputError, match="not a regular file"):
        VirtualKittiVariant(variant)
