"""Answers of others, scored by the names of the frames; runs; classes that are joined."""

import numpy as np
import pytest

from layouts.evaluation import run, score
from layouts.pictures import write

LEFT = np.arange(64) < 32


@pytest.fixture
def data(tmp_path):
    """Two frames: road in the left half, cars in the right one; a wall at 10 m."""
    ids = np.where(LEFT, np.full((40, 64), 3), 7).astype(np.uint8)
    for name in ("a", "b"):
        write(tmp_path / f"set/images/{name}.png", np.full((40, 64, 3), 90, np.uint8))
        write(tmp_path / f"set/labels/{name}.png", ids)
        write(tmp_path / f"set/depth/{name}.png", np.full((40, 64), 2560, np.uint16))
    keys = 'labels=labels,depth=depth,label_ids={3="road",7="car"}'
    return ["--data", f"folders:{tmp_path}/set,{keys}", "--lidar", "none"]


def test_ids_and_depth_are_found_by_the_names_of_the_frames(data, tmp_path):
    """8-bit PNGs of a set's ids, 16-bit PNGs and .npy of depth; a quarter of the road is wrong."""
    ids = np.where(np.arange(64) < 24, np.zeros((40, 64)), 1).astype(np.uint8)
    for name in ("a", "b"):
        write(tmp_path / f"theirs/{name}.png", ids)
        (tmp_path / f"theirs/{name}.png").rename(tmp_path / f"theirs/{name}.PNG")
        write(tmp_path / f"png/set/{name}.png", np.full((40, 64), 11_000, np.uint16))
        (tmp_path / "both/depth").mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / f"both/depth/{name}.npy", np.full((1, 40, 64), 12, np.float32))
        write(tmp_path / f"both/semantic/{name}.png", ids.astype(np.uint16))
    names = 'classes=["road","car"]'
    options = [f"{tmp_path}/theirs", f"{tmp_path}/png,depth_scale=1000", f"{tmp_path}/both"]
    options = [f"{options[0]},{names}", options[1], f"{options[2]},{names}"]
    found, output = score(*data, *(part for each in options for part in ("--predictions", each)))
    theirs, png, both = (row["figures"] for row in found)
    assert theirs["miou"] == both["miou"] == pytest.approx((24 / 32 + 32 / 40) / 2)
    assert "mae_m" not in theirs
    assert "miou" not in png
    assert (png["mae_m"], both["mae_m"]) == pytest.approx((1, 2))
    assert "than theirs" in output


def test_predictions_that_do_not_fit_say_why(data, tmp_path):
    write(tmp_path / "some/a.png", np.zeros((40, 64), np.uint8))
    write(tmp_path / "small/a.png", np.zeros((20, 32), np.uint8))
    write(tmp_path / "high/a.png", np.full((40, 64), 9, np.uint8))
    write(tmp_path / "flat/depth/a.png", np.full((40, 64), 9, np.uint8))
    write(tmp_path / "twice/a.png", np.zeros((40, 64), np.uint8))
    np.save(tmp_path / "twice/a.npy", np.zeros((40, 64), np.uint8))
    (tmp_path / "link").mkdir()
    (tmp_path / "link/a.png").symlink_to("/nowhere/a.png")
    (tmp_path / "folder/a.png").mkdir(parents=True)
    (tmp_path / "zip").mkdir()
    np.savez(tmp_path / "zip/a.npz", np.zeros((40, 64), np.uint8))
    (tmp_path / "zip/a.npz").rename(tmp_path / "zip/a.npy")
    (tmp_path / "float/semantic").mkdir(parents=True)
    np.save(tmp_path / "float/semantic/a.npy", np.zeros((40, 64)))
    for folder, text in (
        ("some", "of the frame b"),
        ("small", "20x32"),
        ("high", "class id 9"),
        ("flat", "must be a depth map"),
        ("twice", "keep one of them"),
        ("float", "expected class ids"),
        ("link", "a.png (No such file or directory)"),
        ("folder", "a.png (Is a directory)"),
        ("zip", "a.npy: cannot be read"),
        ("none", "no such folder"),
        ("some,colour=1", "unknown key colour"),
    ):
        result = run(*data, "--predictions", tmp_path / folder)
        assert result.exit_code == 1
        assert text in result.output.splitlines()[-1]
    assert run(*data).exit_code == 2
    (tmp_path / "page.html").touch()
    result = run("--data", "folders:none", "ssdnet-nano", "--page", tmp_path / "page.html")
    assert "page.html exists: choose another name" in result.output  # before data are read


def test_classes_count_as_one_where_a_file_says_so(data, tmp_path):
    """A model of trucks and vehicles on labels of cars: names match in any case, and joined."""
    ids = np.where(LEFT, np.zeros((40, 64)), np.where(np.arange(64) < 48, 1, 2)).astype(np.uint8)
    for name in ("a", "b"):
        write(tmp_path / f"theirs/{name}.png", ids)
    theirs = f'{tmp_path}/theirs,classes=["Road","truck","vehicle"]'
    ((apart,), _) = score(*data, "--predictions", theirs)
    assert apart["figures"]["miou"] == apart["figures"]["iou_road"] == 1
    assert "car" in apart["left_out"]
    (tmp_path / "join.toml").write_text('vehicle = ["car", "truck"]\n')
    ((joined,), _) = score(*data, "--predictions", theirs, "--join", tmp_path / "join.toml")
    ious = {key: value for key, value in joined["figures"].items() if key.startswith("iou_")}
    assert ious == {"iou_road": 1, "iou_vehicle": 1}
    both = 'vehicle = ["car"]\nVehicle = ["truck"]'
    for text, words in (
        ('vehicle = ["lorry"]', "'lorry'"),
        ("vehicle = 1", "not a list"),
        (both, "case only"),
    ):
        (tmp_path / "join.toml").write_text(text)
        result = run(*data, "--predictions", theirs, "--join", tmp_path / "join.toml")
        assert result.exit_code == 1
        assert words in result.output
