"""A recording as a data set: what the engine reads, with truth beside it."""

import cv2
import numpy as np
import pytest

from layouts.pictures import write
from runtime.base.errors import DatasetError
from runtime.recordings.folders import FolderSource
from training.base.stop_signal import StopRequested
from training.datasets.recording import RecordingRecipe
from training.loading.open_dataset import count_frames, count_shared, open_dataset

SIZE = (24, 32)


@pytest.fixture
def root(tmp_path):
    """Four frames with one return each, two with denser truth, three with labels."""
    for number in range(4):
        returns, dense = np.zeros(SIZE, np.uint16), np.full(SIZE, 256 * 9, np.uint16)
        returns[20, 5 + number] = 256 * (number + 1)
        returns[0, 0] = 65535  # is no measurement
        folder = tmp_path / "drive"
        write(folder / "images" / f"{number}.png", np.full((*SIZE, 3), 10 * number, np.uint8))
        write(folder / "depth" / f"{number}.png", returns)
        if number < 2:
            write(folder / "dense" / f"{number}.png", dense)
        if number < 3:
            write(folder / "ids" / f"{number}.png", np.full(SIZE, number, np.uint8))
    (tmp_path / "drive" / "camera.toml").write_text(
        "intrinsics = [[30, 0, 16], [0, 30, 12], [0, 0, 1]]\npoints_in = 'camera'\n"
    )
    return tmp_path


def open_drive(root, path="drive", stop=lambda: False, **keys):
    return open_dataset(RecordingRecipe(path=path, **keys), [root], classes="camvid", stop=stop)


def test_returns_are_the_target_or_the_input_of_denser_truth(root):
    alone = open_drive(root, calibration="camera.toml")
    frames = [alone[index] for index in range(len(alone))]
    assert [frame.name for frame in frames] == [f"drive/{number}" for number in range(4)]
    assert [frame.depth[20, 5 + number] for number, frame in enumerate(frames)] == [1, 2, 3, 4]
    assert [frame.is_scan for frame in frames] == [True] * 4
    assert all((frame.scan_line >= 0).sum() == 1 for frame in frames)
    assert {frame.focal_length_px for frame in frames} == {30.0}

    beside = open_drive(root, truth="dense", labels="ids", frames=(1, 2, 3), semantic_weight=0.5)
    dense, labelled, plain = beside[0], beside[1], beside[2]
    assert np.unique(dense.depth).tolist() == [9.0]
    assert dense.returns[20, 6] == 2.0
    assert (dense.semantic == 1).all()
    assert np.count_nonzero(labelled.depth) == 1
    assert labelled.is_scan
    assert "semantic" not in plain.targets
    assert plain.weights["semantic"] == 0.5

    (root / "drive" / "depth" / "1.png").unlink()
    without_returns = open_drive(root, truth="dense", frames=(1,))[0]
    assert without_returns.returns is None
    assert np.unique(without_returns.depth).tolist() == [9.0]


def test_keys_and_ranges_are_those_of_the_engine_and_of_other_sets(root):
    keys = {"source": "folders", "keys": {"depth_scale": 128}}
    found = open_drive(root, "drive/images", depth="../depth", first=1, last=2, **keys)
    assert [found[index].depth.max() for index in range(len(found))] == [4.0, 6.0]
    for keys, text in (
        ({"keys": {"scale": 2}}, "not `scale=`"),
        ({"depth": "none"}, "cannot list the folder"),
        ({"first": 9}, "4 images, none of them in 9"),
    ):
        with pytest.raises(DatasetError, match=text):
            open_drive(root, "drive/images", **{"depth": "../depth", **keys})


def test_a_stream_is_read_once_in_its_order_and_held(root, monkeypatch):
    opened = open_drive(root)
    expected = [opened[index] for index in range(len(opened))]
    read, order = FolderSource.read, []
    monkeypatch.setattr(FolderSource, "is_stream", True)
    monkeypatch.setattr(
        FolderSource, "read", lambda self, frame: order.append(frame.name) or read(self, frame)
    )
    held = open_drive(root)
    for index in (3, 0, 3):
        np.testing.assert_array_equal(held[index].rgb, expected[index].rgb)
        np.testing.assert_array_equal(held[index].depth, expected[index].depth)
    assert order == ["0", "1", "2", "3"]
    # Frames of a stream have no files, and are known by what they show.
    later = open_drive(root, first=2)
    assert (count_frames([held, later]), count_shared([held], [later])) == (4, 2)
    order.clear()
    with pytest.raises(StopRequested):
        open_drive(root, stop=lambda: len(order) == 2)
    assert order == ["0", "1"]


def test_a_file_is_a_recording_too(root):
    video = cv2.VideoWriter(
        str(root / "drive.mkv"), cv2.VideoWriter.fourcc(*"FFV1"), 10, SIZE[::-1]
    )
    for number in range(4):
        video.write(np.full((*SIZE, 3), 40 * number + 9, np.uint8))
    video.release()
    with pytest.raises(DatasetError, match="no recording 'missing"):
        open_drive(root, "missing.mkv")
    found = open_drive(root, "drive.mkv", depth="drive/depth")
    assert [found[index].depth.max() for index in (3, 0)] == [4.0, 1.0]
