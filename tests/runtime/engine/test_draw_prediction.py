"""A prediction draws and saves itself, in a line each, and loads nothing for it before."""

import dataclasses
import subprocess
import sys

import cv2
import numpy as np
import pytest

from runtime import InputError, OutputError, Predictor
from runtime.drawing.overlay import Overlay

K = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])


@pytest.fixture
def answered(model_file, make_frame):
    """(rgb, prediction) of a frame of 48 x 64."""
    rgb, depth = make_frame(48, 64)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    with Predictor(model_file(heads=heads), threads=1) as predictor:
        return rgb, predictor.predict(rgb, depth)


def change(prediction, *, without=(), **changes):
    """The prediction with other fields, without some heads."""
    heads = {head: values for head, values in prediction.heads.items() if head not in without}
    return dataclasses.replace(prediction, **{"heads": heads} | changes)


def test_the_picture_is_the_overlay_red_first(contract, answered):
    rgb, prediction = answered
    drawn = prediction.draw(rgb)
    expected = Overlay(contract.classes, contract.max_depth_m).draw(rgb, prediction)
    np.testing.assert_array_equal(drawn[..., ::-1], expected)
    np.testing.assert_array_equal(drawn[24:48, :64], rgb[24:48])  # its first panel
    alone = prediction.draw()
    assert alone.shape[1] == drawn.shape[1] - 64
    for index, info in enumerate(contract.classes):
        assert (alone[24:48, :64][prediction.semantic[24:48] == index] == info.color).all()


def test_an_answer_that_cannot_be_used_is_drawn(answered):
    rgb, prediction = answered
    depth = prediction.depth.copy()
    depth[30:] = np.nan
    broken = change(prediction, heads={**prediction.heads, "depth": depth}, valid=False)
    drawn = broken.draw(rgb)
    depth_panel = drawn[48:96, :64]  # two panels in a row
    assert (depth_panel[30:] == 110).all(), "no depth there"


@pytest.mark.parametrize("rgb", [np.zeros((48, 63, 3), np.uint8), np.zeros((48, 64, 3)), "x"])
def test_a_picture_of_another_frame_is_refused(answered, rgb):
    with pytest.raises(InputError, match="48, 64, 3"):
        answered[1].draw(rgb)
    with pytest.raises(InputError, match="contract"):
        dataclasses.replace(answered[1], contract=None).draw()


@pytest.mark.parametrize(("suffix", "worst"), [(".png", 0), (".JPG", 90), (".jpeg", 90)])
def test_a_picture_is_saved(tmp_path, answered, suffix, worst):
    rgb, prediction = answered
    prediction.save(tmp_path / f"a{suffix}", rgb)
    read = cv2.imread(str(tmp_path / f"a{suffix}"), cv2.IMREAD_COLOR_RGB)
    drawn = prediction.draw(rgb)
    assert read.shape == drawn.shape
    assert abs(read.astype(int) - drawn).mean() <= worst / 3


def test_all_arrays_are_saved(tmp_path, answered):
    _, prediction = answered
    prediction = change(prediction, without=["boundary"], degraded=("no_depth", "b"))
    prediction.save(str(tmp_path / "a.npz"))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        heads = {"semantic", "depth", "depth_uncertainty"}
        assert set(arrays) == {*heads, "valid", "degraded"}
        for head in heads:
            assert arrays[head].dtype == getattr(prediction, head).dtype
            np.testing.assert_array_equal(arrays[head], getattr(prediction, head))
        assert arrays["valid"]
        assert arrays["degraded"].tolist() == ["no_depth", "b"]


def test_a_cloud_is_saved_with_colours_and_labels(tmp_path, answered, read_ply, contract):
    rgb, prediction = answered
    prediction.save(tmp_path / "a.ply", rgb, intrinsics=K)
    lines, points = read_ply(tmp_path / "a.ply")
    cloud = prediction.points(K, rgb)
    assert 0 < len(points) == len(cloud.points)
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(points[name], cloud.points[:, axis])
    for channel, name in enumerate(("red", "green", "blue")):
        np.testing.assert_array_equal(points[name], cloud.rgb[:, channel])
    np.testing.assert_array_equal(points["label"], cloud.semantic)
    np.testing.assert_array_equal(points["uncertainty"], cloud.uncertainty)
    assert "comment label 1 red 200 30 30" in lines


def test_a_cloud_without_picture_and_classes_is_points_alone(tmp_path, answered, read_ply):
    prediction = change(answered[1], without=["semantic", "depth_uncertainty"], contract=None)
    prediction.save(tmp_path / "a.ply", intrinsics=K)
    assert read_ply(tmp_path / "a.ply")[1].dtype.names == ("x", "y", "z")


def test_a_name_of_a_class_does_not_break_the_header(tmp_path, answered, read_ply, contract):
    classes = (contract.classes[0], dataclasses.replace(contract.classes[0], name="Straße\nend"))
    spoiled = dataclasses.replace(contract, classes=classes)
    dataclasses.replace(answered[1], contract=spoiled).save(tmp_path / "a.ply", intrinsics=K)
    assert "comment label 1 Stra?e end 0 0 128" in read_ply(tmp_path / "a.ply")[0]


@pytest.mark.parametrize(("name", "error", "text"), [
    ("a.ply", InputError, "intrinsics="), ("a.tiff", InputError, r"\.tiff must end"),
    ("none/a.png", OutputError, "cannot write"),
])  # fmt: skip
def test_what_cannot_be_saved_leaves_nothing(tmp_path, answered, name, error, text):
    with pytest.raises(error, match=text):
        answered[1].save(tmp_path / name)
    assert not [path for path in tmp_path.iterdir() if path.name != "model.onnx"]


def test_the_engine_loads_nothing_that_draws():
    program = "import sys; from runtime import Predictor; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "runtime.engine.prediction" in loaded
    assert not [name for name in loaded if name.startswith("runtime.drawing")]
