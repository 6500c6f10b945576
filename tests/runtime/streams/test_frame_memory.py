"""What streams do with a memory; the scenes are those of `test_memory`."""

import numpy as np
import pytest

from drive_to_wall import CALIBRATION, PERIOD_NS, SIZE, pose, scan
from runtime.base.errors import InputError
from runtime.geometry.rig import Rig
from runtime.streams.push_stream import PushStream
from runtime.streams.replay import replay

RIG = Rig(calibration=CALIBRATION, pose_frame="camera", memory_s=2.0)


class Recorder:
    """Keeps what a predictor is fed."""

    def __init__(self, predictor):
        self.predictor, self.fed = predictor, []
        self.focal_length_px = None

    def predict(self, rgb, sparse_depth, **options):
        self.fed.append(sparse_depth.copy())
        return self.predictor.predict(rgb, sparse_depth, **options)


def messages(count, *, poses=pose, without=()):
    rgb = np.random.default_rng(0).integers(0, 255, (*SIZE, 3), np.uint8)
    for number in range(count):
        stamp_ns = 10**12 + number * PERIOD_NS
        if poses is not None and number not in without:
            yield "pose", poses(float(number)), stamp_ns
        yield "image", rgb, stamp_ns
        yield "depth", scan(number), stamp_ns


@pytest.fixture
def answers(checked_predictor):
    """Replay messages; returns what was fed, and the answers."""

    def run(rig=RIG, count=6, consistency=None, **changes):
        recorder = Recorder(checked_predictor())
        given = messages(count, **changes)
        found = replay(recorder, given, rig, check_depth=False, consistency=consistency)
        return recorder.fed, list(found)

    return run


def rig(memory_s, pose_frame="camera"):
    return Rig(calibration=CALIBRATION, pose_frame=pose_frame, memory_s=memory_s)


def test_earlier_returns_are_fed_and_counted_apart(answers):
    alone_fed, alone = answers(rig(0))
    fed, found = answers()
    for number in range(6):
        more = (fed[number] > 0) & (alone_fed[number] == 0)
        assert np.count_nonzero(more) == found[number].memory_returns
        np.testing.assert_array_equal(fed[number][~more], alone_fed[number][~more])
        assert found[number].prediction.depth_returns == alone[number].prediction.depth_returns
        assert found[number].health == alone[number].health
    assert found[0].memory_returns == 0
    assert found[5].memory_returns > 500
    assert found[5].memory_rejected < 0.5


def test_a_live_stream_feeds_the_same(answers, checked_predictor):
    fed, found = answers()
    recorder = Recorder(checked_predictor())
    with PushStream(recorder, RIG, check_depth=False) as stream:
        results = []
        for kind, data, stamp_ns in messages(6):
            getattr(stream, f"push_{'depth' if kind == 'depth' else kind}")(data, stamp_ns)
            if kind == "depth":
                results.append(next(stream))
    assert [each.memory_returns for each in results] == [each.memory_returns for each in found]
    np.testing.assert_array_equal(recorder.fed[5], fed[5])


def test_without_poses_nothing_changes(answers):
    fed, found = answers(rig(2.0, pose_frame=None), poses=None)
    for number, depth in enumerate(fed):
        np.testing.assert_array_equal(depth, scan(number))
    assert all(each.memory_rejected is None for each in found)


def test_returns_that_are_held_out_are_not_fed_again(answers):
    fed, found = answers(consistency=0.2)
    alone_fed, _ = answers(rig(0), consistency=0.2)
    number = len(fed) - 1
    held_out = (scan(5) > 0) & (alone_fed[number] == 0)
    assert held_out.any()
    assert not fed[number][held_out].any()
    assert found[5].memory_returns > 0


def test_poses_that_end_empty_the_memory_without_an_error(answers):
    _, found = answers(count=12, without=range(4, 9))
    returns = [each.memory_returns for each in found]
    assert returns[3] > 0
    assert returns[7] == returns[9] == 0
    assert returns[11] > 0


@pytest.mark.parametrize("seconds", [-1, 11, np.nan, "2"])
def test_a_wrong_memory_is_an_error(seconds):
    with pytest.raises(InputError, match="memory_s must be"):
        Rig(memory_s=seconds)
