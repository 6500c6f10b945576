"""Sources that hold files open are refused in a process that was forked after they were opened."""

import os

import numpy as np
import pytest

from runtime import InputError, open_source
from small_rig import write_video

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def refused_in_child(use):
    """Return whether `use` raises an InputError that names the fork in a child of this process."""
    child = os.fork()
    if not child:
        refused = False
        try:
            use()
        except InputError as error:
            refused = "forked" in str(error) and "in each process" in str(error)
        finally:
            os._exit(refused)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1


def require_guarded(source):
    frames = source.list_frames()
    first = source.read(frames[0]).rgb.copy()
    assert refused_in_child(lambda: source.read(frames[1]))
    assert refused_in_child(lambda: source.read(frames[0])), "also what was read ahead"
    rest = [source.read(frame).rgb for frame in frames]
    assert np.array_equal(rest[0], first)
    assert len({each.tobytes() for each in rest}) == len(rest), "the parent goes on"


@pytest.mark.parametrize("kind", ["ros1", "ros2", "mcap"])
def test_a_bag(record, kind):
    pytest.importorskip("rosbags", reason="rosbags (extra bag) is not installed")
    with open_source("bag", record(kind, images=4, scans=4).write()) as source:
        require_guarded(source)
        assert refused_in_child(source.list_frames)


def test_a_video(tmp_path):
    path = write_video(tmp_path / "drive.mp4", "mp4v", (20, 70, 120, 170))
    with open_source("video", path) as source:
        require_guarded(source)
