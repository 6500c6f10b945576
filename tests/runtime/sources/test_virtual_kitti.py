"""A variant of a Virtual KITTI 2 scene through ssdnet-run."""

import os

import cv2
import numpy as np
import pytest

from runtime import InputError
from runtime.sources.virtual_kitti import VirtualKittiSource

ROWS = "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n"


@pytest.fixture
def variant(tmp_path, make_frame, write_rgb):
    """Four frames of both cameras; every pixel has depth [cm], the upper rows are sky."""
    folder = tmp_path / "Scene01/clone"
    rows = ""
    for number in range(4):
        for camera in (0, 1):
            rgb, _ = make_frame(seed=number + 10 * camera)
            write_rgb(folder / f"frames/rgb/Camera_{camera}/rgb_{number:05d}.jpg", rgb)
            path = folder / f"frames/depth/Camera_{camera}/depth_{number:05d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), centimetres(number, camera))
            rows += f"{number} {camera} {70 + camera} 70 32 24\n"
    (folder / "intrinsic.txt").write_text(ROWS + rows)
    return folder


def centimetres(number, camera):
    depth = np.full((48, 64), 65535, np.uint16)
    depth[10:] = 500 + 100 * number + 1000 * camera + np.arange(38)[:, None]
    return depth


@pytest.mark.parametrize("camera", [0, 1])
def test_a_variant_from_end_to_end(variant, run, camera):
    answers = run(variant, "--camera", camera)
    assert answers.exit_code == 0, answers.text
    assert answers.names == ["00000", "00001", "00002", "00003"]
    for number in range(4):
        fed = answers.fed_depth(f"{number:05d}")
        assert not fed[:10].any()
        assert abs(fed[10:] - centimetres(number, camera)[10:] / 100).max() < 0.01
    assert answers.report["inputs"]["focal_length_px"] == 70 + camera


def test_a_frame_that_lacks_its_partner_or_is_damaged_is_counted(variant, run):
    frames = variant / "frames"
    (frames / "rgb/Camera_0/rgb_00001.jpg").unlink()
    (frames / "depth/Camera_0/depth_00002.png").write_bytes(b"")
    answers = run("--source", f"vkitti:{variant}")
    assert answers.exit_code == 3
    assert answers.column("status") == ["ok", "skipped", "skipped", "ok"]
    assert answers.column("reason")[1] == "00001 has a depth map, but no image"
    assert run("--source", f"vkitti:{variant}", "--limit", 2, "--overwrite").names == [
        "00000",
        "00001",
        "00002",
    ], "2 complete ones"


def test_the_sky_has_no_depth(variant):
    source = VirtualKittiSource(variant)
    depth = source.read(source.list_frames()[0]).sparse_depth
    assert not depth[:10].any()
    assert (depth[10:] > 0).all()


def test_without_intrinsics_the_focal_length_is_not_known(variant, run):
    (variant / "intrinsic.txt").unlink()
    answers = run("--source", f"vkitti:{variant}")
    assert answers.exit_code == 0
    assert answers.report["inputs"]["focal_length_px"] is None


@pytest.mark.parametrize("content", ["", ROWS, "0 1 70 70 32 24\n", "0 0 x 70 32 24\n"])
def test_intrinsics_without_the_camera_are_an_error(variant, run, content):
    (variant / "intrinsic.txt").write_text(content)
    answers = run("--source", f"vkitti:{variant}")
    assert answers.exit_code == 1
    assert "has no row 'frame cameraID fx fy cx cy' of camera 0" in answers.text.replace("\n", " ")


def test_the_error_for_a_whole_scene_asks_for_a_variant(variant, run):
    answers = run("--source", f"vkitti:{variant.parent}")
    assert answers.exit_code == 1
    assert "give a folder like Scene01/clone" in answers.text.replace("\n", " ")


def test_folders_that_share_no_number_are_an_error(variant, run):
    for number in range(4):
        (variant / f"frames/rgb/Camera_0/rgb_{number:05d}.jpg").rename(
            variant / f"frames/rgb/Camera_0/rgb_{number + 4:05d}.jpg"
        )
    answers = run("--source", f"vkitti:{variant}")
    assert answers.exit_code == 1
    assert "no number occurs both" in answers.text.replace("\n", " ")


def test_a_pipe_in_place_of_the_intrinsics_is_not_waited_for(variant):
    (variant / "intrinsic.txt").unlink()
    os.mkfifo(variant / "intrinsic.txt")
    with pytest.raises(InputError, match="not a regular file"):
        VirtualKittiSource(variant)
