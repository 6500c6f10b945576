"""What is written is what was predicted, whole or not at all, and only in a folder of our own."""

import dataclasses
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import OutputError, Predictor
from runtime.atomic_write import atomic_file
from runtime.drawing.overlay import Overlay
from runtime.stream.outputs.frame_writer import (
    FrameWriter,
    encode_boundary,
    encode_metres,
    encode_semantic,
)
from runtime.stream.run_folder import KINDS


@pytest.fixture
def answered(model_file, make_frame):
    """(rgb, prediction) of a frame."""
    rgb, depth = make_frame(60, 80)
    rgb[..., 1] = rgb[..., 2] // 2  # boundary = green / blue stays within 0..1
    heads = ("semantic", "depth", "boundary", "depth_uncertainty")
    return rgb, Predictor(model_file(heads=heads)).predict(rgb, depth)


def decode(content: bytes):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def files_in(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_metres_are_rounded_and_clipped_and_zero_stays_none():
    depth = np.array([[0, 1, 80.001, 1.5 / 256, 2.4 / 256, 255.999, 300, 1e9]], np.float32)
    image = decode(encode_metres(depth))
    assert image.dtype == np.uint16
    assert image.tolist() == [[0, 256, 20480, 2, 2, 65535, 65535, 65535]]


def test_boundary_and_semantic():
    boundary = np.array([[0, 0.5, 1, 0.2]], np.float32)
    assert decode(encode_boundary(boundary)).tolist() == [[0, 128, 255, 51]]
    semantic = np.random.default_rng(0).integers(0, 255, (37, 41), dtype=np.uint8)
    assert np.array_equal(decode(encode_semantic(semantic)), semantic)


def test_a_frame_is_written(tmp_path, contract, answered):
    rgb, prediction = answered
    out = tmp_path / "deep" / "out"
    FrameWriter(out, contract, kinds=KINDS).write("0007", rgb, prediction)
    assert files_in(out) == {
        ".ssdnet-run",
        "semantic/0007.png",
        "depth/0007.png",
        "uncertainty/0007.png",
        "boundary/0007.png",
        "overlay/0007.jpg",
    }
    semantic = cv2.imread(str(out / "semantic/0007.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(semantic, prediction.semantic)
    depth = cv2.imread(str(out / "depth/0007.png"), cv2.IMREAD_UNCHANGED) / 256
    assert abs(depth - prediction.depth).max() <= 0.5 / 256 + 1e-6
    uncertainty = cv2.imread(str(out / "uncertainty/0007.png"), cv2.IMREAD_UNCHANGED) / 256
    assert abs(uncertainty - prediction.depth / 16).max() <= 0.5 / 256 + 1e-6
    boundary = cv2.imread(str(out / "boundary/0007.png"), cv2.IMREAD_UNCHANGED) / 255
    assert abs(boundary - prediction.boundary).max() <= 0.5 / 255 + 1e-6


def test_only_what_was_asked_for_and_what_the_model_has(tmp_path, contract, answered):
    rgb, prediction = answered
    prediction = dataclasses.replace(prediction, boundary=None, depth_uncertainty=None)
    kinds = ("semantic", "boundary", "uncertainty")
    writer = FrameWriter(tmp_path / "out", contract, kinds=kinds)
    writer.write("a", rgb, prediction)
    assert files_in(tmp_path / "out") == {".ssdnet-run", "semantic/a.png"}


def test_what_a_format_cannot_hold_is_an_output_error(tmp_path, contract, answered, monkeypatch):
    monkeypatch.setattr(Overlay, "draw", lambda *_: np.zeros((8, 65600, 3), np.uint8))
    writer = FrameWriter(tmp_path / "out", contract, kinds=KINDS)
    with pytest.raises(OutputError, match=r"cannot encode .*a\.jpg.*leave out overlay"):
        writer.write("a", *answered)
    assert files_in(tmp_path / "out") == {".ssdnet-run"}


# --- the folder --------------------------------------------------------------------------------


def test_an_empty_folder_may_be_used(tmp_path, contract):
    FrameWriter(tmp_path, contract, kinds=("depth",))
    assert (tmp_path / "depth").is_dir()


def test_a_used_folder_is_refused(tmp_path, contract, answered):
    FrameWriter(tmp_path / "out", contract, kinds=KINDS).write("a", *answered)
    before = files_in(tmp_path)
    with pytest.raises(OutputError, match=r"not empty.*--overwrite"):
        FrameWriter(tmp_path / "out", contract, kinds=KINDS)
    assert files_in(tmp_path) == before


def test_overwrite_replaces_our_own_run_and_nothing_else(tmp_path, contract, answered):
    out = tmp_path / "out"
    names = ("old", "two\nlines", "g\udcff1")
    writer = FrameWriter(out, contract, kinds=KINDS)
    for name in names:
        writer.write(name, *answered)
    with atomic_file(out / "depth" / "old.png") as file:
        leftover = str(Path(file.name).relative_to(out))
    mine = {"mine.txt", "depth/mine.png", "overlay/holiday.jpg", "semantic/.mine.png.part"}
    for name in ("frames.csv", "report.json", "latency.png", leftover, *mine):
        (out / name).write_text("x")
    (out / "boundary" / "old.png").unlink()
    (out / "boundary" / "old.png").mkdir()  # a folder is not ours, whatever its name
    FrameWriter(out, contract, kinds=("depth",), overwrite=True).write("new", *answered)
    assert files_in(out) == {".ssdnet-run", "depth/new.png", *mine}
    assert (out / "boundary" / "old.png").is_dir()
    FrameWriter(out, contract, kinds=(), overwrite=True)
    assert files_in(out) == {".ssdnet-run", *mine}


@pytest.fixture
def earlier_run(tmp_path, contract, answered):
    """A folder with a run of the frame "a", whose report was written."""
    FrameWriter(tmp_path / "out", contract, kinds=KINDS).write("a", *answered)
    (tmp_path / "out" / "report.json").write_text("{}")
    return tmp_path / "out"


def refuse_to_overwrite(out, contract, text, **options):
    """Check that nothing was touched, there or elsewhere."""
    before = {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}
    with pytest.raises(OutputError, match=text):
        FrameWriter(out, contract, overwrite=True, **options)
    assert before == {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}


def test_overwrite_writes_nothing_through_a_link(tmp_path, contract, earlier_run):
    (earlier_run / "depth").rename(tmp_path / "pictures")
    (earlier_run / "depth").symlink_to(tmp_path / "pictures")
    text = r"out/depth is a link or a file in the place"
    refuse_to_overwrite(earlier_run, contract, text, kinds=("semantic", "depth"))
    (earlier_run / "depth").unlink()
    (earlier_run / "depth").symlink_to(tmp_path / "none")
    refuse_to_overwrite(earlier_run, contract, text, kinds=("depth",))
    (earlier_run / "depth").unlink()
    (earlier_run / "depth").touch()
    refuse_to_overwrite(earlier_run, contract, text, kinds=("depth",))
    FrameWriter(earlier_run, contract, kinds=("semantic",), overwrite=True)


def test_overwrite_replaces_no_file_of_another(tmp_path, contract, earlier_run, answered):
    foreign = earlier_run / "depth" / "b.png"
    foreign.write_text("mine")
    text = r"out/depth/b\.png is not of the earlier run"
    refuse_to_overwrite(earlier_run, contract, text, names=("a", "b"))
    foreign.unlink()
    foreign.symlink_to(tmp_path / "none")
    refuse_to_overwrite(earlier_run, contract, text, names=("a", "b"))
    FrameWriter(earlier_run, contract, kinds=("semantic",), names=("a", "b"), overwrite=True)
    assert foreign.is_symlink()


def test_overwrite_replaces_no_folder_of_another(contract, earlier_run):
    (earlier_run / "depth" / "a.png").unlink()
    (earlier_run / "depth" / "a.png").mkdir()
    text = r"out/depth/a\.png is not of the earlier run"
    refuse_to_overwrite(earlier_run, contract, text, names=("a",))


def test_overwrite_does_not_follow_links_out_of_the_folder(tmp_path, contract, answered):
    out, pictures = tmp_path / "out", tmp_path / "pictures"
    FrameWriter(out, contract, kinds=("semantic",)).write("a", *answered)
    (out / "semantic").rename(pictures)
    (out / "semantic").symlink_to(pictures)
    FrameWriter(out, contract, kinds=("depth",), overwrite=True)
    assert files_in(pictures) == {"a.png"}


def test_overwrite_says_what_it_could_not_remove(contract, earlier_run, read_only):
    read_only(earlier_run / "depth")
    with pytest.raises(OutputError, match=r"cannot remove the earlier run.*depth/a\.png"):
        FrameWriter(earlier_run, contract, kinds=KINDS, overwrite=True)
    assert not (earlier_run / "report.json").exists(), "a run with a report is whole"


def test_overwrite_never_touches_a_folder_that_is_not_ours(tmp_path, contract):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0001.png").write_text("a data set")
    with pytest.raises(OutputError, match="did not make"):
        FrameWriter(tmp_path, contract, kinds=KINDS, overwrite=True)
    assert files_in(tmp_path) == {"depth/0001.png"}


def test_a_folder_that_cannot_be_made(tmp_path, contract):
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "out", Path("/proc/none/out")):
        with pytest.raises(OutputError, match="cannot make the output folder"):
            FrameWriter(out, contract, kinds=KINDS)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path, contract):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        FrameWriter(tmp_path / "out", contract, kinds=KINDS)


# --- whole or not at all -----------------------------------------------------------------------


def test_a_frame_that_fails_half_way_leaves_none_of_its_files(tmp_path, contract, answered):
    out = tmp_path / "out"
    writer = FrameWriter(out, contract, kinds=KINDS)
    writer.write("good", *answered)
    before = files_in(out)
    (out / KINDS[-1]).rename(tmp_path / "away")
    (out / KINDS[-1]).touch()  # in the place of its folder
    with pytest.raises(OutputError, match=r"Not a directory.*is kept"):
        writer.write("bad", *answered)
    (out / KINDS[-1]).unlink()
    (tmp_path / "away").rename(out / KINDS[-1])
    assert files_in(out) == before


def test_a_disk_that_is_really_full(mount_disk, contract, answered):
    tiny_disk = mount_disk(64)
    writer = FrameWriter(tiny_disk / "out", contract, kinds=KINDS)
    finished: list[str] = []

    def write_frames():
        for index in range(100):
            writer.write(str(index), *answered)
            finished.append(str(index))

    with pytest.raises(OutputError, match="No space left on device"):
        write_frames()
    assert 0 < len(finished) < 100
    for kind in KINDS:
        written = {path.stem for path in (tiny_disk / "out" / kind).iterdir()}
        assert written == set(finished), "whole frames only, nothing temporary"


# --- the overlay -------------------------------------------------------------------------------


def panels_of(strip, height):
    return [strip[i * height : (i + 1) * height] for i in range(5)]


def test_the_overlay_shows_what_was_predicted(contract, answered):
    _, prediction = answered
    height, width = 100, 300
    rgb = np.full((height, width, 3), (250, 10, 20), np.uint8)
    semantic = np.ones((height, width), np.uint8)
    semantic[:, :150] = 0
    depth = np.full((height, width), 2, np.float32)
    depth[:, 150:] = 80
    boundary = np.zeros((height, width), np.float32)
    boundary[:, 150:] = 1
    uncertainty = np.full((height, width), 1, np.float32)
    prediction = dataclasses.replace(
        prediction,
        semantic=semantic,
        depth=depth,
        boundary=boundary,
        depth_uncertainty=uncertainty,
        frame_size=(height, width),
    )
    strip = Overlay(contract.classes, contract.max_depth_m).draw(rgb, prediction)
    image, classes, depths, uncertainties, boundaries = panels_of(strip, height)
    assert image[60, 60].tolist() == [20, 10, 250], "blue first"
    dark, red = np.array([128, 0, 0]), np.array([30, 30, 200])
    for column, color in ((60, dark), (240, red)):
        expected = 0.7 * color + 0.3 * np.array([20, 10, 250])
        assert abs(classes[60, column] - expected).max() <= 1
    near, far = depths[60, 60].astype(int), depths[60, 240].astype(int)
    assert near.sum() > 500, "near is bright"
    assert far.sum() < 20, "the far end is black"
    unsure, sure = uncertainties[60, 60].astype(int), uncertainties[60, 240].astype(int)
    assert unsure[1] > 200, "a metre at 2 m is bright"
    assert sure.sum() < 250, "a metre at 80 m is dark"
    assert boundaries[60, 60].tolist() == [0, 0, 0]
    assert boundaries[60, 240].tolist() == [255, 255, 255]
    assert strip.shape[0] > 5 * height, "the legend"


def test_the_depth_colours_are_the_same_for_every_frame(contract, answered):
    rgb, prediction = answered
    overlay = Overlay(contract.classes, contract.max_depth_m)

    def color_at_10_m(rest_m):
        depth = np.full(prediction.depth.shape, rest_m, np.float32)
        depth[40, 40] = 10
        drawn = overlay.draw(rgb, dataclasses.replace(prediction, depth=depth))
        return drawn[40, 2 * 80 + 40].tolist()

    assert color_at_10_m(1) == color_at_10_m(70)


def depth_panels(overlay, answered, **changes):
    """The panels of the depth and of its uncertainty: 60 x 80 pixels each."""
    rgb, prediction = answered
    drawn = overlay.draw(rgb, dataclasses.replace(prediction, **changes))
    return drawn[:60, 2 * 80 : 3 * 80], drawn[:60, 3 * 80 : 4 * 80]


def test_the_sky_has_no_depth(contract, answered, monkeypatch):
    titles = []
    monkeypatch.setattr(
        "runtime.drawing.overlay.write_text", lambda picture, text, at: titles.append(text)
    )
    grey = [110, 110, 110]
    ids = np.zeros((60, 80), np.uint8)
    ids[:30] = 1
    plain = Overlay(contract.classes, contract.max_depth_m)
    sky = (contract.classes[0], dataclasses.replace(contract.classes[1], name="Sky"))
    without = depth_panels(plain, answered, semantic=ids)
    assert "depth" in titles
    titles.clear()
    with_sky = depth_panels(Overlay(sky, contract.max_depth_m), answered, semantic=ids)
    assert "depth, none in the sky" in titles
    for hidden, shown in zip(with_sky, without, strict=True):
        assert (hidden[:30] == grey).all()
        assert np.array_equal(hidden[30:], shown[30:])
        assert not (shown == grey).all(axis=-1).any()
    titles.clear()
    unknown = depth_panels(Overlay(sky, contract.max_depth_m), answered, semantic=None)
    assert "depth" in titles, "without classes nothing is known to be sky"
    assert not (unknown[0] == grey).all(axis=-1).any()


def test_a_depth_that_is_none_is_not_drawn_as_near(contract, answered):
    depth = np.full((60, 80), 20, np.float32)
    depth[40:, :40], depth[40:, 40:] = 0, -1
    plain = Overlay(contract.classes, contract.max_depth_m)
    for panel in depth_panels(plain, answered, depth=depth):
        assert (panel[40:] == 110).all()
        assert not (panel[20:40] == 110).all(axis=-1).any()


@pytest.mark.parametrize(
    "size",
    [(375, 1242), (512, 1024), (125, 414), (33, 35), (1080, 1920), (32, 20600), (65600, 32)],
)
def test_the_overlay_of_any_size_is_of_a_handy_size(contract, answered, size):
    _, prediction = answered
    resized = {
        name: cv2.resize(getattr(prediction, name), size[::-1])
        for name in ("semantic", "depth", "boundary", "depth_uncertainty")
    }
    prediction = dataclasses.replace(prediction, frame_size=size, **resized)
    overlay = Overlay(contract.classes, contract.max_depth_m)
    strip = overlay.draw(np.zeros((*size, 3), np.uint8), prediction)
    assert strip.dtype == np.uint8
    assert strip.shape[1] <= (960 if size[1] >= 2 * size[0] else 5 * 640)
    assert strip.shape[0] <= 5 * 4096 + 200


@pytest.mark.parametrize(
    ("size", "width"), [((256, 832), 832), ((375, 1242), 621), ((480, 959), 5 * 479)]
)
def test_panels_below_one_another_may_be_wider(contract, answered, size, width):
    resized = {
        name: cv2.resize(getattr(answered[1], name), size[::-1])
        for name in ("semantic", "depth", "boundary", "depth_uncertainty")
    }
    overlay = Overlay(contract.classes, contract.max_depth_m)
    answers = dataclasses.replace(answered[1], **resized)
    assert overlay.draw(np.zeros((*size, 3), np.uint8), answers).shape[1] == width


def test_the_overlay_leaves_out_missing_heads(contract, answered):
    rgb, prediction = answered
    no_uncertainty = dataclasses.replace(prediction, depth_uncertainty=None)
    only_depth = dataclasses.replace(no_uncertainty, semantic=None, boundary=None)
    overlay = Overlay(contract.classes, contract.max_depth_m)
    assert overlay.draw(rgb, only_depth).shape[1] == 2 * 80
    assert overlay.draw(rgb, no_uncertainty).shape[1] == 4 * 80
    assert overlay.draw(rgb, prediction).shape[1] == 5 * 80
    only_boundary = dataclasses.replace(no_uncertainty, semantic=None, depth=None)
    assert Overlay((), contract.max_depth_m).draw(rgb, only_boundary).shape == (60, 2 * 80, 3)


def test_the_legend_speaks_of_the_uncertainty_where_it_is_drawn(contract, answered):
    _, prediction = answered
    wide = {
        name: cv2.resize(getattr(prediction, name), (200, 60))
        for name in ("semantic", "depth", "boundary", "depth_uncertainty")
    }
    prediction = dataclasses.replace(prediction, **wide)
    overlay = Overlay(contract.classes, contract.max_depth_m)
    rgb = np.zeros((60, 200, 3), np.uint8)
    with_it = overlay.draw(rgb, prediction)
    without = overlay.draw(rgb, dataclasses.replace(prediction, depth_uncertainty=None))
    lines = (with_it.shape[0] - 5 * 60) - (without.shape[0] - 4 * 60)
    assert lines == 22
    assert np.array_equal(with_it[5 * 60 : -lines], without[4 * 60 :])


def test_the_overlay_leaves_the_frame_alone(contract, answered):
    rgb, prediction = answered
    given = (rgb, prediction.semantic, prediction.depth, prediction.depth_uncertainty)
    given += (prediction.boundary,)
    before = [a.copy() for a in given]
    Overlay(contract.classes, contract.max_depth_m).draw(rgb, prediction)
    assert all(np.array_equal(a, b) for a, b in zip(before, given, strict=True))


def test_a_depth_alone_has_the_overlays_colours_at_its_own_size(contract, answered):
    _, prediction = answered
    sky = (contract.classes[0], dataclasses.replace(contract.classes[1], name="sky"))
    overlay = Overlay(sky, contract.max_depth_m)
    ids = np.ones((60, 80), np.uint8)
    ids[:, 40:] = 0
    alone = overlay.paint_depth(prediction.depth, ids)
    panel, _ = depth_panels(overlay, answered, semantic=ids)
    np.testing.assert_array_equal(alone[24:], panel[24:])  # without the words
    assert (alone[:, :40] == 110).all()
    assert not (overlay.paint_depth(prediction.depth) == 110).all(axis=-1).any()
