"""Two folders as a source, and one alone."""

import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from runtime import InputError, project_points
from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from runtime.recordings.folders import FolderSource
from runtime.recordings.registry import open_source
from runtime.recordings.source import files_by_number


@pytest.fixture
def folders(tmp_path, make_frame, write_rgb, write_depth):
    """Five frames in cam/ and lidar/; the depth map of 1 and the picture of 3 are missing."""
    depths = {}
    for index in range(5):
        rgb, depths[index] = make_frame(seed=index)
        write_rgb(tmp_path / f"cam/{index}.png", rgb)
        write_depth(tmp_path / f"lidar/{index}.png", depths[index])
    (tmp_path / "lidar/1.png").unlink()
    (tmp_path / "cam/3.png").unlink()
    return tmp_path / "cam", tmp_path / "lidar", depths


def test_folders_from_end_to_end(folders, run):
    rgb, depth, depths = folders
    answers = run("--source", f"folders:{rgb}", "--depth", depth)
    assert answers.exit_code == 3, answers.text
    assert answers.column("status") == ["ok", "skipped", "ok", "skipped", "ok"]
    assert answers.column("reason")[1] == "1 has an image, but no depth map"
    assert answers.column("reason")[3] == "3 has a depth map, but no image"
    for name in ("0", "2", "4"):
        assert abs(answers.fed_depth(name) - depths[int(name)]).max() < 0.01
    by_flags = run("--rgb", rgb, "--depth", depth, out="other")
    assert answers.report["inputs"] == by_flags.report["inputs"]


def test_an_image_and_its_depth_map_are_one_frame(folders, tmp_path):
    images, maps, depths = folders
    (tmp_path / "other").mkdir()
    other = shutil.copy(maps / "4.png", tmp_path / "other/depth.png")
    for depth, expected in ((other, depths[4]), (maps, depths[4]), (None, 0 * depths[4])):
        source = open_source("folders", images / "4.png", depth=depth)
        (listed,) = source.list_frames()
        assert listed.name == "4"
        assert abs(source.read(listed).sparse_depth - expected).max() < 0.01
    with pytest.raises(InputError, match="0, 2, 3"):
        open_source("folders", images / "1.png", depth=maps).list_frames()
    with pytest.raises(InputError, match=r"4\.png"):
        open_source("folders", images, depth=maps / "4.png").list_frames()


def test_a_limit_counts_complete_frames(folders):
    rgb, depth, _ = folders
    source = FolderSource(rgb, depth=depth)
    assert [f.name for f in source.list_frames(limit=2)] == ["0", "1", "2"]
    assert [f.sequence for f in source.list_frames()] == [0, 1, 2, 3, 4]
    assert [f.complete for f in source.list_frames()] == [True, False, True, False, True]


# --- depth in other formats, and scans --------------------------------------------------------


INTRINSICS = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
EXTRINSICS = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, 0.5], [0, 0, 0, 1]])
MATRICES = f"intrinsics = {INTRINSICS.tolist()}\nextrinsics = {EXTRINSICS.tolist()}\n"


def with_marks(scan):
    """A scan with ten points without a return; the camera would see them at the LiDAR."""
    marks = np.repeat(np.float32([[0, 0, 0, 0], [np.nan] * 4]), 5, axis=0)
    return np.vstack([marks, scan])


@pytest.fixture
def scans(folders, make_scan, tmp_path):
    """Scans of cam/ in scans/, of three formats, without one of 1.png; a calibration."""
    folder = tmp_path / "scans"
    folder.mkdir()
    for number in (0, 3):
        with_marks(make_scan(number)).tofile(folder / f"{number}.bin")
    np.pad(with_marks(make_scan(2)), ((0, 0), (0, 1))).tofile(folder / "2.pcd.bin")
    for number in (4, 5):
        np.save(folder / f"{number}.npy", with_marks(make_scan(number))[:, :3].astype(np.float64))
    shutil.copy(folders[0] / "0.png", folders[0] / "3.png")
    shutil.copy(folders[0] / "0.png", folders[0] / "5.png")
    (tmp_path / "calibration.toml").write_text(f"size = [48, 64]\n{MATRICES}")
    return folder, tmp_path / "calibration.toml"


def test_scans_of_several_formats_are_projected_beside_their_images(folders, scans, make_scan):
    source = FolderSource(folders[0], Rig(calibration=scans[1]), points=scans[0])
    frames = source.list_frames()
    assert [each.name for each in frames] == ["0", "1", "2", "3", "4", "5"]
    with pytest.raises(InputError, match="1 has an image, but no scan"):
        source.read(frames[1])
    for listed in (frames[0], *frames[2:]):
        frame = source.read(listed)
        expected = project_points(make_scan(int(listed.name)), INTRINSICS, EXTRINSICS, (48, 64))
        assert (expected > 0).sum() > 100
        assert abs(frame.sparse_depth - expected).max() < 0.01
        assert frame.compensated.lost_points == 10
    assert (source.inputs["points"], source.inputs["calibration"]) == tuple(map(str, scans))
    assert source.calibration.focal_length_px == 60


LENS = 'lens = "plumb_bob"\ndistortion = [-0.2, 0.05, 0.01, -0.01, 0]\n'


def test_scans_are_projected_through_the_lens_or_into_rectified_images(folders, scans, make_scan):
    folder, path = scans
    path.write_text(path.read_text() + LENS)
    calibration, size = Calibration.from_file(path), (48, 64)
    source = FolderSource(folders[0], Rig(calibration=path), points=folder)
    listed = source.list_frames()[0]
    raw = source.read(listed)
    expected = calibration.project(make_scan(0), size)
    np.testing.assert_array_equal(raw.sparse_depth, expected)
    source.rectify_images()
    frame = source.read(listed)
    assert (raw.calibration.lens, frame.calibration.lens) == ("plumb_bob", None)
    straight = calibration.rectified.project(make_scan(0), size)
    np.testing.assert_array_equal(frame.sparse_depth, straight)
    np.testing.assert_array_equal(frame.rgb, calibration.rectify(raw.rgb))
    assert (straight != expected).any()


def test_a_run_rectifies_and_warns_of_a_lens_that_ends_inside_the_images(folders, scans, run):
    images, (folder, path) = folders[0], scans
    plain = path.read_text()
    assert "no calibration" in run("--rgb", images, "--rectify").text
    options = ["--rgb", images, "--points", folder, "--calibration", path]
    path.write_text(plain + LENS)
    answers = run(*options, "--rectify")
    assert answers.exit_code == 3, answers.text  # 1.png has no scan
    inputs = answers.report["inputs"]
    assert (inputs["rectified_by_this_run"], inputs["lens"]) == (True, "plumb_bob")
    path.write_text(plain + 'lens = "plumb_bob"\ndistortion = [-3.5, 0, 0, 0]\n')
    warned = run(*options, out="other").text
    assert "warning: the lens of the calibration, plumb_bob [-3.5, 0.0, 0.0, 0.0], ends" in warned


def test_what_cannot_be_rectified(folders, scans):
    images, path = folders[0], scans[1]
    with pytest.raises(InputError, match="no lens"):
        FolderSource(images, Rig(calibration=path)).rectify_images()
    path.write_text(path.read_text() + LENS)
    source = FolderSource(images, Rig(calibration=path), depth=folders[1])
    source.rectify_images()
    with pytest.raises(InputError, match="depth map"):
        source.read(source.list_frames()[0])


def test_scans_need_extrinsics_and_paths_may_be_text(folders, scans, tmp_path):
    rig = Rig(calibration=str(scans[1]))
    source = open_source("folders", str(folders[0]), rig, points=str(scans[0]))
    assert source.calibration.focal_length_px == 60
    numbers = tmp_path / "intrinsics.txt"
    numbers.write_text("60 0 32 0 60 24 0 0 1")
    with pytest.raises(InputError, match="intrinsics alone"):
        open_source("folders", folders[0], Rig(calibration=numbers), points=scans[0])
    with pytest.raises(InputError, match="calibration="):
        open_source("folders", folders[0], points=scans[0])
    assert open_source("folders", folders[0], Rig(calibration=numbers)).calibration is not None


def test_scans_take_the_place_of_depth_maps(folders, scans):
    images, maps, _ = folders
    for options in ({"depth": maps, "points": scans[0]}, {"points": maps}):
        with pytest.raises(InputError, match=r"not both|\.png files"):
            open_source("folders", images, Rig(calibration=scans[1]), **options).list_frames()


@pytest.fixture
def kitti(tmp_path, make_frame, make_scan, write_rgb):
    """An image in image_3/, a scan, and calibrations; extrinsics of the cameras, by number."""
    write_rgb(tmp_path / "image_3/0.png", make_frame()[0])
    (tmp_path / "scans").mkdir()
    make_scan().tofile(tmp_path / "scans/0.bin")
    for link, target in (("right", "image_3"), ("data", "image_3"), ("image_0", "image_3")):
        (tmp_path / link).symlink_to(target)
    (tmp_path / "plain").mkdir()
    shutil.copy(tmp_path / "image_3/0.png", tmp_path / "plain/0.png")
    (tmp_path / "image_1").symlink_to("plain")
    shifts = {0: 0.0, 1: -32.4, 2: 2.7, 3: -20.4}

    def write(name, shifts):
        rows = [f"P{n}: 60 0 32 {shift} 0 60 24 0 0 0 1 0" for n, shift in shifts.items()]
        rows += ["R0_rect: 1 0 0 0 1 0 0 0 1", "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0"]
        (tmp_path / name).write_text("\n".join(rows))

    write("calib.txt", shifts)
    write("one_camera.txt", {2: 2.7})
    write("rectified_alike.txt", dict.fromkeys(range(4), 0.0))
    (tmp_path / "own.toml").write_text(MATRICES)
    return {camera: shift / 60 for camera, shift in shifts.items()}


@pytest.mark.parametrize(("images", "calibration", "key", "camera", "warns"), [
    ("image_3", "calib.txt", None, 3, False),
    (".", "calib.txt", None, 3, False),
    ("0.png", "calib.txt", None, 3, False),
    ("../right", "calib.txt", None, 3, False),
    ("../right/0.png", "calib.txt", None, 3, False),
    ("../image_0", "calib.txt", None, 3, False),  # the real name, not that of the link
    ("../image_1", "calib.txt", None, 1, False),  # the real name says nothing
    ("image_3", "calib.txt", 0, 0, False),
    ("../plain", "calib.txt", None, 2, True),
    ("../plain/0.png", "calib.txt", None, 2, True),
    ("../plain", "calib.txt", 2, 2, False),
    ("../plain", "one_camera.txt", None, 2, False),
    ("../plain", "rectified_alike.txt", None, 0, False),
    ("../plain", "own.toml", None, None, False),
])  # fmt: skip
def test_the_camera_of_kitti_is_that_of_the_real_folder(
    kitti, tmp_path, monkeypatch, images, calibration, key, camera, warns
):
    monkeypatch.chdir(tmp_path / "image_3")
    path = tmp_path / images if images == "image_3" else images
    rig, options = Rig(calibration=tmp_path / calibration), {"points": tmp_path / "scans"}
    with open_source("folders", path, rig, camera=key, **options) as source:
        shift = kitti[camera] if camera is not None else EXTRINSICS[0, 3]
        assert source.calibration.extrinsics[0, 3] == pytest.approx(shift)
        warning = f"warning: assumed camera 2 of KITTI for {path}: `camera=`"
        assert [note.startswith(warning) for note in source.notes] == [True] * warns
    # Depth maps lie on the pixels of their image, whichever camera it is of.
    with open_source("folders", path, rig) as source:
        assert source.notes == ()


# --- listing ----------------------------------------------------------------------------------


@pytest.fixture
def empty_folders(tmp_path):
    """Make rgb/ and depth/ with empty files of the given names."""

    def make(rgb, depth):
        for folder, names in (("rgb", rgb), ("depth", depth)):
            (tmp_path / folder).mkdir()
            for name in names:
                (tmp_path / folder / name).touch()
        return tmp_path / "rgb", tmp_path / "depth"

    return make


def listed(rgb, depth, **options):
    return FolderSource(rgb, depth=depth).list_frames(**options)


def test_names_that_are_times_are_in_their_order(empty_folders, tmp_path):
    names = [str(1700000000 + 0.05 * number) for number in range(9)]
    rgb, _ = empty_folders([f"{name}.png" for name in names], ["0.png"])
    (tmp_path / "times.txt").write_text("\n".join(names))
    frames = FolderSource(rgb, timestamps=tmp_path / "times.txt").list_frames()
    assert [frame.name for frame in frames] == names
    assert all(abs(f.image_stamp_ns - float(f.name) * 1e9) < 1e3 for f in frames)


@pytest.mark.parametrize("names", [["0.05", "0.1"], ["1700000000.1"]])
def test_times_are_no_numbers_of_frames(names):
    files = {name: Path(f"{name}.png") for name in names}
    with pytest.raises(InputError, match="must end in the number of its frame"):
        files_by_number(files)
    assert list(files_by_number({"left.07": Path("left.07.png")})) == [7]


@pytest.mark.parametrize(("rgb", "depth"), [
    (["1.png", "2.png", "10.png"], ["0001.png", "0002.png", "0010.png"]),
    (["f_01_2.png", "f_1_10.png"], ["lidar1-02.png", "lidar1-10.png"]),
    (["0.05.png", "0.1.png", "0.15.png"], ["depth_0.05.png", "depth_0.10.png", "depth_0.15.png"]),
])  # fmt: skip
def test_numbers_are_the_same_with_zeros_in_front(empty_folders, rgb, depth):
    images, maps = empty_folders(rgb, depth)
    source = FolderSource(images, depth=maps)
    frames = source.list_frames()
    assert [frame.image.name for frame in frames] == rgb
    assert [frame.depth.name for frame in frames] == depth
    assert source.notes[0].endswith(f"as {rgb[0]} with {depth[0]}")


def test_names_are_compared_in_one_normal_form(empty_folders):
    """Letters with accents are decomposed by macOS, and by no other system."""
    names = ["Köln.png", "Zürich.png"]
    images, maps = empty_folders(names, [unicodedata.normalize("NFD", name) for name in names])
    frames = FolderSource(images, depth=maps).list_frames()
    assert [frame.name for frame in frames] == ["Köln", "Zürich"]
    assert all(frame.complete for frame in frames)


@pytest.mark.parametrize(("depth", "is_said"), [
    (["0.png", "1.png", "2.png"], True), (["1.png", "2.png", "3.png"], False),
    (["0.png", "1.png", "2.png", "3.png"], False), (["2.png", "3.png", "5.png"], False),
])  # fmt: skip
def test_numbers_from_0_beside_numbers_from_1_are_said(empty_folders, depth, is_said):
    images, maps = empty_folders(["1.png", "2.png", "3.png"], depth)
    source = FolderSource(images, depth=maps)
    source.list_frames()
    assert any("images numbered from 1 and depth maps" in n for n in source.notes) == is_said


@pytest.mark.parametrize(("rgb", "depth", "named"), [
    (["1.png", "01.png"], ["001.png", "2.png"], "depth"),
    (["left_1.png"], ["depth_1.png", "other_1.png"], "no name occurs in both"),
    ([], ["1.png"], "rgb has no"),
    (["1.png"], [], "depth has no"),
    (["1.png"], ["1.jpg"], "depth has no"),
    (["1.png"], ["2.png"], "has 1, .* has 2"),
    (["1.png", "1.jpg"], ["1.png"], "same stem"),
    (["1.png"], ["1.png", "1.npy"], "same stem"),
])  # fmt: skip
def test_folders_that_make_no_stream(empty_folders, rgb, depth, named):
    with pytest.raises(InputError, match=named):
        listed(*empty_folders(rgb, depth))
