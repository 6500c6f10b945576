"""Sources by their kind, and their options. A source is a file and a line of SOURCES."""

from pathlib import Path

import numpy as np
import pytest

from runtime import InputError
from runtime.app.run.options import RunOptions, UsageError
from runtime.geometry.poses import PoseFrame
from runtime.geometry.rig import Rig
from runtime.recordings.listing import ListedFrame, limit_frames
from runtime.recordings.registry import SOURCES, detect_source, open_source, parse_source
from runtime.recordings.source import Source

KINDS = "one of the kinds kitti-raw, kitti-object, video, bag, one-folder, folders"


@pytest.mark.parametrize("text", ["", "folders", "folders:", "folder:/tmp", ":/tmp", "/tmp"])
def test_what_is_no_kind_and_path_is_an_error_with_the_kinds(text):
    with pytest.raises(InputError, match=KINDS):
        parse_source(text)


def test_keys_are_read_by_their_types(monkeypatch):
    monkeypatch.setenv("HOME", "/home/driver")
    text = "folders:~/a,point_columns=5,depth_scale=1e3,timestamps=~/t.txt,pose_frame=body"
    home, numbers = Path("/home/driver"), {"point_columns": 5, "depth_scale": 1000.0}
    others = {"timestamps": home / "t.txt"}
    found = parse_source(f"{text},scan_stamp=end")
    assert found[:3] == ("folders", home / "a", numbers | others)
    assert found.rig == Rig(pose_frame=PoseFrame.BODY, scan_stamp="end")
    topics = {"depth_topic": "none", "image_topic": "/a", "rectified": True, "registered": False}
    text = "bag:x.mcap,depth_topic=none,image_topic=/a,rectified=true,registered=false"
    assert parse_source(text).keys == topics


def test_a_path_may_hold_colons_commas_and_equals_signs(tmp_path):
    assert parse_source("folders:a:b").path == Path("a:b")
    assert parse_source("bag:a, b,c.mcap,info_topic=/x=1,y").path == Path("a, b,c.mcap")
    assert parse_source("bag:a=b,depth_topic=none").path == Path("a=b")
    for name in ("run=3,sensor=2", "t,0=1"):
        (tmp_path / name).mkdir()
        given = f"folders:{tmp_path / name},timestamps={tmp_path / name}"
        assert parse_source(given).path == tmp_path / name
        assert parse_source(given).keys == {"timestamps": tmp_path / name}


@pytest.mark.parametrize("keys", [
    "depth_scale=0", "depth_scale=nan", "depth_scale=1e-50", "depth_scale=", "point_columns=2",
    "point_columns=4.5", "point_time_column=1", "pose_frame=wheel", "scan_stamp=first",
    "timestamps=", "depth_scale=1,depth_scale=2", "topic=2", "depth-scale=2",
    "depth_scale=2,scale=3", "camera=4", "camera=-1", "rectified=true",
])  # fmt: skip
def test_a_wrong_key_is_a_usage_error_that_names_it(keys):
    wrong = keys.split(",")[-1].split("=")[0]
    with pytest.raises(UsageError, match=wrong):
        RunOptions(source=f"folders:no,{keys}")


def test_python_may_give_keys_as_the_text_of_the_command(tmp_path, write_rgb, make_frame):
    write_rgb(tmp_path / "rgb/0.png", make_frame()[0])
    given = {"depth": str(tmp_path / "rgb"), "depth_scale": "1e3"}
    with open_source("folders", str(tmp_path / "rgb"), **given) as source:
        assert source.inputs["depth_scale"] == 1000
    with pytest.raises(InputError, match="rectified must be true or false, got 'no'"):
        open_source("bag", tmp_path / "x.mcap", rectified="no")
    with pytest.raises(InputError, match=r"depth_scale must be units per metre, .* got 'mm'"):
        open_source("folders", tmp_path, depth_scale="mm")


def test_options_of_another_kind_are_wrong_usage_of_the_command(tmp_path):
    with pytest.raises(UsageError, match="not `depth=`"):
        RunOptions(source=f"kitti-raw:{tmp_path}", depth=tmp_path)
    with pytest.raises(UsageError, match=KINDS):
        RunOptions(source="nothing:here")


@pytest.mark.parametrize("name", ["", "notes.txt", "none", "none.mp4"])
def test_a_path_that_is_no_source_is_an_error_with_what_is_accepted(tmp_path, name):
    (tmp_path / "notes.txt").touch()
    fault = "does not exist" if "none" in name else "is none of these"
    with pytest.raises(
        InputError, match=rf"{fault}.*KITTI raw.*\.mp4.*\.mcap.*image\*/ and depth\*/"
    ):
        detect_source(tmp_path / name)


def test_the_kind_may_be_found_by_the_path(tmp_path, write_rgb, make_frame):
    write_rgb(tmp_path / "rgb/0.png", make_frame()[0])
    with open_source("auto", tmp_path / "rgb") as source:
        assert len(source.list_frames()) == 1
    with pytest.raises(InputError, match="does not exist"):
        open_source("auto", tmp_path / "none")


def test_an_unknown_kind_is_an_input_error_with_the_kinds(tmp_path):
    with pytest.raises(InputError, match=KINDS):
        open_source("folder", tmp_path)


def test_what_describes_the_car_belongs_to_its_rig_and_must_be_of_use(tmp_path):
    with pytest.raises(InputError, match=r"give Rig\(calibration="):
        open_source("folders", tmp_path, calibration="car.toml")
    with pytest.raises(InputError, match=r"kitti-object takes .* not `max_skew_ms=`"):
        open_source("kitti-object", tmp_path, Rig(max_skew_ms=20))


@pytest.mark.parametrize("kind", SOURCES)
def test_a_path_that_is_not_there_is_an_input_error(kind, tmp_path):
    with pytest.raises(InputError, match="nothing"):
        open_source(kind, tmp_path / "nothing").list_frames()


class ArchiveSource(Source):
    """A new source is such a class, here with an option that others have, ..."""

    accepted = "arrays rgb and depth in one .npz file"
    options = ("depth_scale",)

    def __init__(self, path, rig, *, depth_scale=1.0):
        self.recordings, self._scale = (path,), depth_scale
        with np.load(path) as arrays:
            self._rgb, self._depth = arrays["rgb"], arrays["depth"]

    @staticmethod
    def accepts(path):
        return path.suffix == ".npz"

    def list_frames(self, *, limit=None):
        frames = (ListedFrame(i, f"frame{i}", i, i) for i in range(len(self._rgb)))
        return limit_frames(frames, limit)

    def read(self, frame):
        depth = np.float32(self._depth[frame.depth] / self._scale)
        return self.measured(frame, self._rgb[frame.image], depth)

    @property
    def inputs(self):
        return {"source": str(self.recordings[0])}


def test_another_source_is_a_file_and_a_line(run, tmp_path, make_frame, monkeypatch):
    monkeypatch.setitem(SOURCES, "archive", ArchiveSource)  # ... and its line
    frames = [make_frame(seed=seed) for seed in range(3)]
    depths = [depth * 4 for _, depth in frames]
    np.savez(tmp_path / "drive.npz", rgb=[rgb for rgb, _ in frames], depth=depths)
    path = tmp_path / "drive.npz"
    answers = run("--source", f"archive:{path},depth_scale=4", "--limit", 2)
    assert answers.exit_code == 0
    assert answers.names == ["frame0", "frame1"]
    returns = frames[1][1]
    fed = answers.fed_depth("frame1")[returns > 0]
    np.testing.assert_allclose(fed, returns[returns > 0], atol=1 / 256)
    assert len(run(path, out="by path").names) == 3
