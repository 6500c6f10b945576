"""What a bag proves of its camera, what is assumed and said, and what is refused."""

import numpy as np
import pytest

from runtime import InputError
from runtime.command.wording import with_flags
from runtime.recordings.bag import BagSource
from small_rig import INTRINSICS, MS, SIZE, START_NS, add_tree, projected

pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")

K = np.array(INTRINSICS)
ZERO = np.zeros((3, 3))
CURVED = (0.1, -0.02, 0.01, 0.02, 0)
TURN = np.array([[0.9998, -0.02, 0], [0.02, 0.9998, 0], [0, 0, 1]])


def scaled(across, down, x=0.0, y=0.0):
    return np.array([[across, 0, x], [0, down, y], [0, 0, 1]]) @ K


def camera(topic, *infos, frame_id="camera", others=(), rig=add_tree):
    """Writes the camera beside CameraInfo messages into a bag."""

    def write(bag, make_frame):
        for index in range(2):
            rgb, _ = make_frame(*SIZE, seed=index)
            bag.image(topic, rgb, "rgb8", START_NS + 100 * MS * index, frame_id=frame_id)
        for stamp_ns, info in enumerate(infos, 1):
            given = {"intrinsics": K, "size": SIZE, "stamp_ns": stamp_ns} | info
            bag.info("/cam/camera_info", given.pop("intrinsics"), given.pop("size"), **given)
        for topic_of_other, frame in others:
            bag.info(topic_of_other, K, SIZE, frame_id=frame)
        rig(bag)

    return write


def pair(bag):
    """The frame "camera" is 0.1 m to the right of the frame "left"."""
    add_tree(bag)
    bag.static_transform("camera", "left", (0, 0, 0, 1), (-0.1, 0, 0))


def twice(bag):
    add_tree(bag)
    bag.static_transform("base", "lidar", (0, 0, 0, 1), (0, 0, 0.4))
    bag.static_transform("base", "lidar", (0, 0, 0, 1), (0, 0, 0.3))


def roi(x, y, height, width):
    return {"x_offset": x, "y_offset": y, "height": height, "width": width}


RAW, RECT = "/cam/image_raw", "/cam/image_rect"
BASELINE = {"shift_px": -6.0}  # 0.1 m
OFF = scaled(1.3, 1.3, 3, 5)  # as for a larger image
STRAIGHT = {"intrinsics": OFF, "rectified": K}  # a rectified image, whose raw one is larger
BENT = STRAIGHT | {"d": CURVED}
BINNED = {"binning_x": 2, "binning_y": 2}
LARGE = {"intrinsics": scaled(2, 2, 0.5, 0.5)} | BINNED
CORNER = {"intrinsics": scaled(1, 1, 9, 4), "roi": roi(9, 4, *SIZE)}
OMNI = {"distortion_model": "omni"}
# Case -> what the bag holds; the options of a case.
RIGHT = {
    "a pinhole": camera(RAW, {}),
    "rectified by its name": camera(RECT, BENT),
    "rectified, in colour": camera("/cam/image_rect_color", STRAIGHT),
    "rectified by its folder": camera("/cam/Rectified/image", STRAIGHT),
    "unrectified by its name": camera("/cam/image_unrectified", {"rectified": OFF}),
    "zeros first": camera(RAW, {"intrinsics": ZERO}, {}),
    "NaN first": camera(RAW, {"intrinsics": np.nan * K}, {}),
    "ones first": camera(RAW, {"intrinsics": np.eye(3)}, {}),
    "autofocus of half a pixel": camera(RAW, {}, {"intrinsics": scaled(1.008, 1.008)}),
    "never rectified": camera(RAW, {"rectified": ZERO}),
    "K is not set": camera(RAW, {"intrinsics": ZERO, "rectified": K}),
    "R is not set": camera(RAW, {"r": ZERO}),
    "the whole region": camera(RAW, {"roi": roi(0, 0, *SIZE)}),
    "a region": camera(RAW, CORNER | {"size": (60, 80)}),
    "binned": camera(RAW, LARGE | {"size": (96, 128)}),
    "binned, with the size of the images": camera(RAW, BINNED),
    "binned, with the size of the images alone": camera(RAW, LARGE),
    "binned, with the K of the images alone": camera(RAW, BINNED | {"size": (96, 128)}),
    "its own frame of a pair": camera(RECT, BASELINE, rig=pair),
    "a slash before the frame": camera(RAW, {"frame_id": "/camera"}),
    "the frame of the CameraInfo alone": camera(RAW, {}, frame_id=""),
    "stated to be rectified": camera("/cam/image", BENT),
    "stated to be raw": camera("/cam/image", {"rectified": OFF}),
}
OPTIONS = {
    "rectified by its folder": {"info_topic": "/cam/camera_info"},
    "stated to be rectified": {"rectified": True},
    "stated to be raw": {"rectified": False},
}
ASSUMED = {
    "kitti2bag": (camera(RAW, BENT), "rectified=True"),
    "no word in the name": (camera("/cam/image", {"rectified": OFF}), "rectified=True"),
    "R": (camera(RECT, {"r": TURN}), "R"),
    "another lens": (camera(RAW, OMNI | {"d": (0, 0)}), "omni"),
    "zoom": (camera(RAW, {}, {"intrinsics": scaled(2, 2)}), "first CameraInfo"),
    "two frames": (camera(RAW, {"frame_id": "lidar"}), "lidar"),
    "two transforms": (camera(RAW, {}, rig=twice), "lidar"),
    "a region with its own size": (camera(RAW, CORNER), "whole sensor"),
    "its own size and K": (camera(RAW, {"roi": roi(9, 4, *SIZE)}), "region of interest"),
    "its own K": (camera(RAW, {"size": (60, 90), "roi": roi(19, 4, *SIZE)}), "region of interest"),
}
REFUSED = {
    "never set": (camera(RAW, {"intrinsics": ZERO}), "K or P"),
    "a region of no size": (camera(RAW, {"size": (60, 80), "roi": roi(9, 4, 20, 20)}), "20, 20"),
    "rectified by its name, no P": (camera(RECT, {"rectified": ZERO, "d": CURVED}), "no P"),
    "R is no rotation": (camera(RAW, {"r": 1.1 * np.eye(3)}), "R must"),
    "no coefficients": (camera(RAW, {"distortion_model": "equidistant"}), "equidistant"),
    "another lens": (camera(RAW, OMNI | {"d": (0.1, 0, 0, 0)}), "omni"),
}


@pytest.fixture
def read(make_bag, make_frame, make_scan):
    """Give the path of a bag, the depth of its first frame, the calibration and the warnings."""

    def read_first(write, **options):
        bag = make_bag()
        write(bag, make_frame)
        for index in range(2):
            bag.cloud("/points", make_scan(index), START_NS + 100 * MS * index)
        path = bag.write()
        with BagSource(path, **options) as source:
            (frame, *_) = source.list_frames(limit=1)
            depth = source.read(frame).sparse_depth
            return path, depth, source.calibration, [n for n in source.notes if "warning" in n]

    return read_first


@pytest.mark.parametrize("case", RIGHT)
def test_what_a_bag_proves_is_used_in_silence(read, make_scan, case):
    _, depth, _, notes = read(RIGHT[case], **OPTIONS.get(case, {}))
    np.testing.assert_allclose(depth, projected(make_scan(0), ahead_m=0.5), atol=1e-3)
    assert not notes


@pytest.mark.parametrize("case", ASSUMED)
def test_what_it_leaves_open_is_assumed_and_said(read, make_scan, run, case):
    write, named = ASSUMED[case]
    path, depth, _, notes = read(write)
    np.testing.assert_allclose(depth, projected(make_scan(0), ahead_m=0.5), atol=1e-3)
    (note,) = notes
    assert note.startswith("warning: assumed ")
    assert named in note
    if case == "kitti2bag":
        answers = run("--source", f"bag:{path}")
        assert with_flags(note) in answers.text.replace("\n", " ")
        assert answers.report["inputs"]["assumptions"] == [with_flags(note)]
        answers = run("--source", f"bag:{path},rectified=true", out="stated")
        assert "warning: assumed" not in answers.text
        assert answers.report["inputs"]["assumptions"] == []


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused(read, case):
    write, text = REFUSED[case]
    with pytest.raises(InputError, match=text):
        read(write)


@pytest.mark.parametrize(("write", "right_m", "said"), [
    (camera(RECT, BASELINE), -0.1, True),
    (camera(RECT, {"intrinsics": ZERO}, BASELINE), -0.1, True),
    (camera(RECT, {"shift_px": 1e-9}), 0, False),
    (camera(RECT, BASELINE, others=[("/left/camera_info", "camera")]), -0.1, False),
    (camera(RECT, BASELINE, rig=pair), 0, False),
    (camera(RECT, BASELINE, rig=pair, others=[("/depth/camera_info", "camera")]), 0, False),
    (camera(RECT, BASELINE, others=[("/left/camera_info", "left")]), -0.1, True),
    (camera(RAW, BASELINE | {"d": CURVED}), 0, False),
])  # fmt: skip
def test_the_baseline_of_a_pair_is_applied_once(read, write, right_m, said):
    """P applies it if the frame is shared with the first camera; otherwise /tf_static does."""
    _, _, calibration, notes = read(write)
    expected = [[0, -1, 0, right_m], [0, 0, -1, -0.3], [1, 0, 0, -0.5], [0, 0, 0, 1]]
    np.testing.assert_allclose(calibration.extrinsics, expected, atol=1e-9)
    assert ["stereo pair's first camera, 0.1 m beside" in note for note in notes] == [True] * said


@pytest.mark.parametrize(("model", "distortion", "lens"), [
    ("fisheye", (0,) * 4, "equidistant"), ("kannala_brandt4", (0,) * 4, "equidistant"),
    ("plumb_bob", (0,) * 4, None), ("", (0,) * 4, None), ("plumb_bob", CURVED, "plumb_bob"),
])  # fmt: skip
def test_a_raw_image_has_the_lens(read, make_scan, model, distortion, lens):
    """A fisheye whose coefficients are 0 is still a fisheye."""
    write = camera(RAW, {"distortion_model": model, "d": distortion})
    _, depth, calibration, notes = read(write)
    assert (calibration.lens, notes) == (lens, [])
    np.testing.assert_array_equal(depth, calibration.project(make_scan(0), SIZE))


# --- depth images ---------------------------------------------------------------------------------

FOCAL = 0.5


@pytest.fixture
def depth_bag(make_bag, make_frame):
    """Give a bag of a camera and a depth camera beside it, of half its focal length: a wall."""

    def make(*, of="depth", frame_id="camera", info=True, tree=True, focal=FOCAL, d=()):
        bag, (rgb, _) = make_bag("ros2"), make_frame(*SIZE)
        depth = np.full(SIZE, 6000, np.uint16)
        depth[:, ::2] = 65535
        bag.image("/rgb/image_raw", rgb, "rgb8", START_NS, frame_id=frame_id)
        bag.image("/depth/image_raw", depth, "16UC1", START_NS, frame_id=of)
        bag.info("/rgb/camera_info", K, SIZE, frame_id=frame_id, d=d)
        if info:
            half = [[60 * focal, 0, 32], [0, 60 * focal, 24], [0, 0, 1]]
            bag.info("/depth/camera_info", half, SIZE, frame_id=of)
        if tree:
            bag.static_transform("camera", "depth", (0, 0, 0, 1), (0, 0, -1.0))
        return bag.write()

    return make


@pytest.mark.parametrize(("changes", "options", "said"), [
    ({"of": "camera", "focal": 1}, {}, False),
    ({"of": "camera"}, {}, True),  # one name for two cameras
    ({"of": "camera", "focal": 1, "d": CURVED}, {}, True),
    ({"of": "camera"}, {"registered": True}, False),
    ({"of": "/camera", "info": False, "tree": False}, {}, False),
    ({}, {"registered": True}, False),
    ({"of": ""}, {}, True),
    ({"frame_id": ""}, {}, True),
])  # fmt: skip
def test_depth_on_the_pixels_of_the_images_is_kept(depth_bag, changes, options, said):
    with BagSource(depth_bag(**changes), **options) as source:
        depth = source.read(source.list_frames()[0]).sparse_depth
        assert ["lies on the pixels" in n for n in source.notes[1:]] == [True] * said
    assert np.isnan(depth[:, ::2]).all()
    np.testing.assert_array_equal(depth[:, 1::2], 6)


@pytest.mark.parametrize("options", [{}, {"registered": False}])
def test_depth_of_another_frame_is_moved_by_its_camera_and_tf(depth_bag, options):
    with BagSource(depth_bag(), **options) as source:
        frame = source.read(source.list_frames()[0])
        assert not any("warning" in note for note in source.notes)
    row, column = np.nonzero(frame.sparse_depth)
    np.testing.assert_allclose(frame.sparse_depth[row, column], 5, rtol=1e-6)
    expected = np.rint((np.arange(1, 64, 2) - 32) / (FOCAL * 60) * 6 / 5 * 60 + 32)
    assert set(column) == set(expected[(expected >= 0) & (expected < 64)])


@pytest.mark.parametrize("changes", [{"info": False}, {"tree": False}])
def test_depth_that_cannot_be_moved_is_refused(depth_bag, changes):
    with pytest.raises(InputError, match="registered=True"):
        BagSource(depth_bag(**changes))
