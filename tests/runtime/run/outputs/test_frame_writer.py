"""What is written is what was predicted, whole or not at all, and only in a folder of our own."""

import dataclasses
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from runtime import OutputError
from runtime.drawing.overlay import Overlay
from runtime.io.atomic_write import atomic_file
from runtime.run.run_folder import KINDS


def named(answered, name):
    frame, prediction = answered
    return dataclasses.replace(frame, name=name), prediction


def files_in(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_a_frame_is_written(tmp_path, make_writer, answered):
    prediction = answered[1]
    out = tmp_path / "deep" / "out"
    make_writer(out, kinds=KINDS).write(*named(answered, "0007"))
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


def test_only_what_was_asked_for_and_what_the_model_has(tmp_path, make_writer, answered):
    frame, prediction = answered
    heads = {head: prediction.heads[head] for head in ("semantic", "depth")}
    prediction = dataclasses.replace(prediction, heads=heads)
    kinds = ("semantic", "boundary", "uncertainty")
    writer = make_writer(tmp_path / "out", kinds=kinds)
    writer.write(frame, prediction)
    assert files_in(tmp_path / "out") == {".ssdnet-run", "semantic/a.png"}


def test_what_a_format_cannot_hold_is_an_output_error(tmp_path, make_writer, answered, monkeypatch):
    monkeypatch.setattr(
        Overlay, "draw", lambda *arguments, **options: np.zeros((8, 65600, 3), np.uint8)
    )
    writer = make_writer(tmp_path / "out", kinds=KINDS)
    with pytest.raises(OutputError, match=r"cannot encode .*a\.jpg.*leave out overlay"):
        writer.write(*answered)
    assert files_in(tmp_path / "out") == {".ssdnet-run"}


# --- the folder --------------------------------------------------------------------------------


def test_an_empty_folder_may_be_used(tmp_path, make_writer):
    make_writer(tmp_path, kinds=("depth",))
    assert (tmp_path / "depth").is_dir()


def test_a_used_folder_is_refused(tmp_path, make_writer, answered):
    make_writer(tmp_path / "out", kinds=KINDS).write(*answered)
    before = files_in(tmp_path)
    with pytest.raises(OutputError, match=r"not empty.*--overwrite"):
        make_writer(tmp_path / "out", kinds=KINDS)
    assert files_in(tmp_path) == before


def test_overwrite_replaces_our_own_run_and_nothing_else(tmp_path, make_writer, answered):
    out = tmp_path / "out"
    names = ("old", "two\nlines", "g\udcff1")
    writer = make_writer(out, kinds=KINDS)
    for name in names:
        writer.write(*named(answered, name))
    with atomic_file(out / "depth" / "old.png") as file:
        leftover = str(Path(file.name).relative_to(out))
    (out / leftover).parent.mkdir()
    mine = {"mine.txt", "depth/mine.png", "overlay/holiday.jpg", "semantic/.mine.png.part"}
    for name in ("frames.csv", "report.json", leftover, *mine):
        (out / name).write_text("x")
    (out / "boundary" / "old.png").unlink()
    (out / "boundary" / "old.png").mkdir()  # a folder is not ours, whatever its name
    make_writer(out, kinds=("depth",), overwrite=True).write(*named(answered, "new"))
    assert files_in(out) == {".ssdnet-run", "depth/new.png", *mine}
    assert (out / "boundary" / "old.png").is_dir()
    make_writer(out, kinds=(), overwrite=True)
    assert files_in(out) == {".ssdnet-run", *mine}


@pytest.fixture
def earlier_run(tmp_path, make_writer, answered):
    """A folder with a run of the frame "a", whose report was written."""
    make_writer(tmp_path / "out", kinds=KINDS).write(*answered)
    (tmp_path / "out" / "report.json").write_text("{}")
    return tmp_path / "out"


def refuse_to_overwrite(out, make_writer, text, **options):
    """Check that nothing was touched, there or elsewhere."""
    before = {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}
    with pytest.raises(OutputError, match=text):
        make_writer(out, overwrite=True, **options)
    assert before == {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}


def test_overwrite_writes_nothing_through_a_link(tmp_path, make_writer, earlier_run):
    (earlier_run / "depth").rename(tmp_path / "pictures")
    (earlier_run / "depth").symlink_to(tmp_path / "pictures")
    text = r"out/depth is a link or a file where"
    refuse_to_overwrite(earlier_run, make_writer, text, kinds=("semantic", "depth"))
    (earlier_run / "depth").unlink()
    (earlier_run / "depth").symlink_to(tmp_path / "none")
    refuse_to_overwrite(earlier_run, make_writer, text, kinds=("depth",))
    (earlier_run / "depth").unlink()
    (earlier_run / "depth").touch()
    refuse_to_overwrite(earlier_run, make_writer, text, kinds=("depth",))
    make_writer(earlier_run, kinds=("semantic",), overwrite=True)


def test_overwrite_replaces_no_file_of_another(tmp_path, make_writer, earlier_run, answered):
    foreign = earlier_run / "depth" / "b.png"
    foreign.write_text("mine")
    text = r"out/depth/b\.png does not belong to the earlier run"
    refuse_to_overwrite(earlier_run, make_writer, text, names=("a", "b"))
    foreign.unlink()
    foreign.symlink_to(tmp_path / "none")
    refuse_to_overwrite(earlier_run, make_writer, text, names=("a", "b"))
    make_writer(earlier_run, kinds=("semantic",), names=("a", "b"), overwrite=True)
    assert foreign.is_symlink()


def test_overwrite_replaces_no_folder_of_another(make_writer, earlier_run):
    (earlier_run / "depth" / "a.png").unlink()
    (earlier_run / "depth" / "a.png").mkdir()
    text = r"out/depth/a\.png does not belong to the earlier run"
    refuse_to_overwrite(earlier_run, make_writer, text, names=("a",))


def test_overwrite_does_not_follow_links_out_of_the_folder(tmp_path, make_writer, answered):
    out, pictures = tmp_path / "out", tmp_path / "pictures"
    make_writer(out, kinds=("semantic",)).write(*answered)
    (out / "semantic").rename(pictures)
    (out / "semantic").symlink_to(pictures)
    make_writer(out, kinds=("depth",), overwrite=True)
    assert files_in(pictures) == {"a.png"}


def test_overwrite_names_what_it_could_not_remove(make_writer, earlier_run, read_only):
    read_only(earlier_run / "depth")
    with pytest.raises(OutputError, match=r"cannot remove the earlier run.*depth/a\.png"):
        make_writer(earlier_run, kinds=KINDS, overwrite=True)
    assert not (earlier_run / "report.json").exists(), "a run with a report is whole"


def test_overwrite_never_touches_a_folder_that_is_not_ours(tmp_path, make_writer):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0001.png").write_text("a data set")
    with pytest.raises(OutputError, match="did not make"):
        make_writer(tmp_path, kinds=KINDS, overwrite=True)
    assert files_in(tmp_path) == {"depth/0001.png"}


def test_a_folder_that_cannot_be_made(tmp_path, make_writer):
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "out", Path("/proc/none/out")):
        with pytest.raises(OutputError, match="cannot make the output folder"):
            make_writer(out, kinds=KINDS)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path, make_writer):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        make_writer(tmp_path / "out", kinds=KINDS)


# --- whole or not at all -----------------------------------------------------------------------


def test_a_frame_that_fails_half_way_leaves_none_of_its_files(tmp_path, make_writer, answered):
    out = tmp_path / "out"
    writer = make_writer(out, kinds=KINDS)
    writer.write(*named(answered, "good"))
    before = files_in(out)
    (out / KINDS[-1]).rename(tmp_path / "away")
    (out / KINDS[-1]).touch()  # in the place of its folder
    with pytest.raises(OutputError, match=r"Not a directory.*are kept"):
        writer.write(*named(answered, "bad"))
    (out / KINDS[-1]).unlink()
    (tmp_path / "away").rename(out / KINDS[-1])
    assert files_in(out) == before


def test_a_disk_that_is_really_full(mount_disk, make_writer, answered):
    tiny_disk = mount_disk(64)
    writer = make_writer(tiny_disk / "out", kinds=KINDS)
    finished: list[str] = []

    def write_frames():
        for index in range(100):
            writer.write(*named(answered, str(index)))
            finished.append(str(index))

    with pytest.raises(OutputError, match="No space left on device"):
        write_frames()
    assert 0 < len(finished) < 100
    for kind in KINDS:
        written = {path.stem for path in (tiny_disk / "out" / kind).iterdir()}
        assert written == set(finished), "whole frames only, nothing temporary"


@pytest.mark.parametrize(
    "line",
    [
        "[" * 100_000,
        '"a\\u0000b"',
        '"\\ud800"',
        '""',
        json.dumps("n" * 300),
        '"../mine"',
        "9" * 5000,
        "null",
        '{"a": 1}',
        "\xff",
    ],
)
def test_an_odd_line_in_the_list_of_frames_names_no_file(make_writer, earlier_run, line):
    with (earlier_run / ".ssdnet-run").open("a", encoding="latin-1") as marker:
        marker.write(line + "\n")
    (earlier_run / "depth" / ".png").write_text("mine")
    (earlier_run / "mine.png").write_text("mine")
    make_writer(earlier_run, kinds=KINDS, overwrite=True)
    assert files_in(earlier_run) == {".ssdnet-run", "depth/.png", "mine.png"}
