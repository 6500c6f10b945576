"""What is written is what was predicted, whole or not at all, and only in a folder of our own."""

import dataclasses
import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli_runs import files_in
from runtime import OutputError
from runtime.app.run.options import KINDS, RunOptions
from runtime.app.run.outputs import frame_writer
from runtime.app.run.outputs.frame_writer import FrameWriter
from runtime.app.run.outputs.mcap import open_mcap
from runtime.files.atomic_write import atomic_file
from runtime.recordings.images import read_sparse_depth


def make_run_folder(out, *, kinds=KINDS, names=(), overwrite=False):
    options = RunOptions(demo=True, out=out, overwrite=overwrite)
    frame_writer.make_run_folder(options, kinds, names)


@pytest.fixture
def write(open_run, answered):
    """Write frames of these names into a run's folder."""

    def make(out, *names, kinds=KINDS, heads=None):
        make_run_folder(out, kinds=kinds, names=names, overwrite=True)
        writer = FrameWriter(open_run(out=out, kinds=kinds))
        frame, result = answered
        given = result.prediction.heads
        kept = {head: given[head] for head in heads or given}
        prediction = dataclasses.replace(result.prediction, heads=kept)
        for name in names:
            named = dataclasses.replace(result, name=name, prediction=prediction)
            writer.write(dataclasses.replace(frame, name=name), named)
        return writer

    return make


def test_a_frame_is_written(tmp_path, write, answered):
    prediction = answered[1].prediction
    out = tmp_path / "deep" / "out"
    write(out, "7")
    files = {"semantic/7.png", "depth/7.png", "uncertainty/7.png", "boundary/7.png"}
    assert files_in(out) == {".ssdnet", "overlay/7.jpg", *files}
    steps = {"semantic": 1, "depth": 256, "depth_uncertainty": 256, "boundary": 255}
    for head, scale in steps.items():
        path = out / head.removeprefix("depth_") / "7.png"
        read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / scale
        error = 0 if head == "semantic" else 0.5 / scale + 1e-6
        np.testing.assert_allclose(read, prediction.heads[head], atol=error, rtol=0)


def test_only_what_was_asked_for_and_what_the_model_has(tmp_path, write):
    kinds = ("semantic", "boundary", "uncertainty")
    write(tmp_path / "out", "a", kinds=kinds, heads=("semantic", "depth"))
    assert files_in(tmp_path / "out") == {".ssdnet", "semantic/a.png"}


def test_depth_that_a_png_cannot_hold_is_counted(tmp_path, open_run, answered):
    frame, result = answered
    heads = dict(result.prediction.heads)
    heads["depth"] = np.full_like(heads["depth"], 20)
    heads["depth"][3, :7] = 300
    heads["depth_uncertainty"] = np.full_like(heads["depth"], 255.9)
    make_run_folder(tmp_path / "out", kinds=("depth", "uncertainty"), names=("a",))
    run = open_run(out=tmp_path / "out", kinds=("depth", "uncertainty"))
    prediction = dataclasses.replace(result.prediction, heads=heads)
    result = dataclasses.replace(result, prediction=prediction)
    FrameWriter(run).write(frame, result)
    assert run.beyond_png == {"depth": 7, "uncertainty": 0}
    if importlib.util.find_spec("rosbags"):
        run = open_run(mcap=tmp_path / "a.mcap")
        with open_mcap(run) as mcap:
            mcap.write(frame, result)
        assert +run.beyond_png == {"depth in the MCAP file": 7}
    again = read_sparse_depth(tmp_path / "out/depth/a.png")
    assert np.isnan(again[3, :7]).all()
    assert (again[4:] == 20).all()


def test_a_frame_that_fails_half_way_leaves_none_of_its_files(tmp_path, write, answered):
    out = tmp_path / "out"
    writer = write(out, "good")
    before = files_in(out)
    (out / KINDS[-1]).rename(tmp_path / "away")
    (out / KINDS[-1]).touch()  # in the place of its folder
    with pytest.raises(OutputError, match=r"Not a directory.*are kept"):
        writer.write(*answered)
    (out / KINDS[-1]).unlink()
    (tmp_path / "away").rename(out / KINDS[-1])
    assert files_in(out) == before


# --- the folder --------------------------------------------------------------------------------


def test_overwrite_replaces_our_own_run_and_nothing_else(tmp_path, write):
    out = tmp_path / "out"
    write(out, "old", "two\nlines", "g\udcff1")
    with pytest.raises(OutputError, match=r"not empty.*overwrite"):
        make_run_folder(out)
    with atomic_file(out / "depth" / "old.png") as file:
        leftover = str(Path(file.name).relative_to(out))
    (out / leftover).parent.mkdir()
    mine = {"mine.txt", "depth/mine.png", "overlay/holiday.jpg", "semantic/.mine.png.part"}
    for name in ("frames.csv", "report.json", leftover, *mine):
        (out / name).write_text("x")
    write(out, "new", kinds=("depth",))
    assert files_in(out) == {".ssdnet", "depth/new.png", *mine}
    make_run_folder(out, kinds=(), overwrite=True)
    assert files_in(out) == {".ssdnet", *mine}


@pytest.fixture
def earlier_run(tmp_path, write):
    """A folder with a run of the frame "a", whose report was written."""
    write(tmp_path / "out", "a")
    (tmp_path / "out" / "report.json").write_text("{}")
    return tmp_path / "out"


def refuse_to_overwrite(out, text, **options):
    """Check that nothing was touched, there or elsewhere."""
    before = {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}
    with pytest.raises(OutputError, match=text):
        make_run_folder(out, overwrite=True, **options)
    assert before == {name: (out.parent / name).read_bytes() for name in files_in(out.parent)}


def test_overwrite_writes_nothing_through_a_link(tmp_path, earlier_run):
    (earlier_run / "depth").rename(tmp_path / "pictures")
    for make in (
        lambda path: path.symlink_to(tmp_path / "pictures"),
        lambda path: path.symlink_to(tmp_path / "none"),
        Path.touch,
    ):
        make(earlier_run / "depth")
        refuse_to_overwrite(earlier_run, r"out/depth is a link or a file where", names=("a",))
        (earlier_run / "depth").unlink()
    (earlier_run / "depth").symlink_to(tmp_path / "pictures")
    make_run_folder(earlier_run, kinds=("semantic",), overwrite=True)
    assert files_in(tmp_path / "pictures") == {"a.png"}, "nor is anything removed through one"


def test_overwrite_replaces_no_file_of_another(tmp_path, earlier_run):
    foreign = earlier_run / "depth" / "b.png"
    text = r"out/depth/b\.png does not belong to the earlier result"
    foreign.write_text("mine")
    refuse_to_overwrite(earlier_run, text, names=("a", "b"))
    foreign.unlink()
    foreign.symlink_to(tmp_path / "none")
    refuse_to_overwrite(earlier_run, text, names=("a", "b"))
    (earlier_run / "cloud").touch()
    make_run_folder(earlier_run, kinds=("semantic",), names=("a", "b"), overwrite=True)
    assert foreign.is_symlink()
    assert (earlier_run / "cloud").is_file()
    (earlier_run / "depth" / "a.png").mkdir()
    refuse_to_overwrite(earlier_run, r"out/depth/a\.png does not belong", names=("a",))


@pytest.mark.parametrize("line", ["[", '"a\\u0000b"', '"../mine"', "9", "null", '{"a": 1}', "\xff"])
def test_a_damaged_list_of_frames_names_no_file(earlier_run, line):
    with (earlier_run / ".ssdnet").open("a", encoding="latin-1") as marker:
        marker.write(line + "\n")
    refuse_to_overwrite(earlier_run, "is damaged")


def test_overwrite_names_what_it_could_not_remove(earlier_run, read_only):
    read_only(earlier_run / "depth")
    with pytest.raises(OutputError, match=r"cannot make the output folder .*depth/a\.png"):
        make_run_folder(earlier_run, overwrite=True)
    assert not (earlier_run / "report.json").exists(), "a run with a report is whole"


def test_overwrite_never_touches_a_folder_that_is_not_ours(tmp_path):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "0001.png").write_text("a data set")
    with pytest.raises(OutputError, match="did not write"):
        make_run_folder(tmp_path, overwrite=True)
    assert files_in(tmp_path) == {"depth/0001.png"}
