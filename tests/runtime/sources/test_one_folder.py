"""A folder that holds everything: as two folders, or file beside file."""

import numpy as np
import pytest

from runtime.sources.folders import FolderSource

CALIBRATION = """intrinsics = [[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]
extrinsics = [[0, -1.0, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
"""


@pytest.fixture
def frames(tmp_path, make_frame, write_rgb, write_depth):
    """Write two frames as files of the given names; their depth maps."""

    def write(image, depth):
        depths = []
        for index in range(2):
            rgb, metres = make_frame(seed=index)
            depths.append(metres)
            write_rgb(tmp_path / "data" / image.format(index), rgb)
            write_depth(tmp_path / "data" / depth.format(index), metres)
        return tmp_path / "data", depths

    return write


@pytest.mark.parametrize(
    ("image", "depth"),
    [
        ("image/{}.png", "depth/{}.png"),
        ("rgb/{}.png", "depth/{}.png"),
        ("Color/{}.png", "sparse_depth_02/{}.png"),
        ("images/left_{}.png", "depth/depth_{}.png"),  # the numbers decide
        ("rgb_{}.png", "depth_{}.png"),
        ("{}_image.png", "{}_depth.png"),
        ("{}.png", "{}_depth.png"),
        ("image/rgb_{}.png", "depth/{}.png"),
        ("{}.jpg", "{}.png"),
        ("rgb_{}.jpg", "depth_{}.png"),
    ],
)
def test_images_and_depth_maps_are_found_by_their_names(frames, run, image, depth):
    data, depths = frames(image, depth)
    answers = run(data)
    assert answers.exit_code == 0, answers.text
    stems = [image.format(index).rpartition("/")[2].rpartition(".")[0] for index in range(2)]
    assert answers.names == stems
    for name, expected in zip(stems, depths, strict=True):
        assert abs(answers.fed_depth(name) - expected).max() < 0.01
    assert answers.report["inputs"]["source"] == f"one-folder:{data}"


def test_pairs_by_numbers_are_said_to_be_guessed(frames, run):
    data, _ = frames("image/left_{}.png", "depth/depth_{}.png")
    text = run(data).text
    assert "guessed: pairs by the numbers in their names, as left_0.png with depth_0.png" in text
    (data / "depth/other_1.png").touch()  # which of the two is the depth of left_1?
    assert "no name occurs in both folders" in run(data, out="twice").text


def test_scans_beside_depth_maps_are_reported_as_not_read(frames, run):
    data, depths = frames("image/{}.png", "depth/{}.png")
    assert "nor read" not in run(data).text
    for name in ("lidar", "velodyne"):
        (data / name).mkdir()
    answers = run(data, out="noted")
    assert answers.exit_code == 0, answers.text
    assert abs(answers.fed_depth("0") - depths[0]).max() < 0.01
    for name in ("lidar", "velodyne"):
        assert f"guessed: {name}/ is not the depth, nor read; --points names it" in answers.text


# --- scans ------------------------------------------------------------------------------------


@pytest.fixture
def scans(tmp_path, make_frame, make_scan, write_rgb):
    """Two images with scans as of nuScenes in one folder."""
    for index in range(2):
        write_rgb(tmp_path / f"data/{index}.jpg", make_frame(seed=index)[0])
        np.pad(make_scan(index), ((0, 0), (0, 1))).tofile(tmp_path / f"data/{index}.pcd.bin")
    return tmp_path / "data"


def test_scans_beside_images_need_a_calibration(scans, run):
    answers = run(scans)
    assert answers.exit_code == 1
    assert "cannot be projected: give --calibration" in answers.text.replace("\n", " ")
    assert set(run("--rgb", scans).column("degraded")) == {"no_depth"}


@pytest.mark.parametrize("name", ["calib.toml", "../given.toml"])
def test_scans_beside_images_are_used_with_a_calibration(scans, run, name):
    (scans / name).write_text(CALIBRATION)
    answers = run(scans, *([] if name == "calib.toml" else ["--calibration", scans / name]))
    assert answers.exit_code == 0, answers.text
    assert all(int(returns) > 100 for returns in answers.column("depth_returns"))


@pytest.mark.parametrize(("folder", "is_scan"), [("points", True), ("depth", False)])
def test_arrays_are_what_their_folder_says(
    tmp_path, make_frame, make_scan, write_rgb, run, folder, is_scan
):
    data = tmp_path / "data"
    write_rgb(data / "image/0.png", make_frame()[0])
    (data / folder).mkdir()
    np.save(data / folder / "0.npy", make_scan() if is_scan else make_frame()[1])
    (data / "calib.toml").write_text(CALIBRATION)
    answers = run(data)
    assert (answers.exit_code, answers.column("degraded")) == (0, [""]), answers.text
    assert ("points" in answers.report["inputs"]) == is_scan


# --- a calibration a frame --------------------------------------------------------------------


def test_a_folder_of_calibrations_has_one_a_frame(scans, run, tmp_path):
    (tmp_path / "calib").mkdir()
    for index, focal in enumerate((60.0, 50.0)):
        text = CALIBRATION.replace("60.0", str(focal)).replace("60,", f"{focal},")
        (tmp_path / f"calib/{index}.toml").write_text(text)
    source = FolderSource(scans, points=scans, calibration=tmp_path / "calib")
    frames = [source.read(listed) for listed in source.list_frames()]
    assert [frame.calibration.focal_length_px for frame in frames] == [60, 50]
    assert source.calibration.focal_length_px == 60
    (tmp_path / "calib/1.toml").unlink()
    given = ["--rgb", scans, "--points", scans, "--calibration", tmp_path / "calib"]
    answers = run(*given)
    assert answers.column("status") == ["ok", "skipped"]
    assert "1 has no calibration in" in answers.column("reason")[1]
