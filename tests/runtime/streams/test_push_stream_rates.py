"""Which frames of a live stream are answered, and sensors at different rates on a moving car."""

import numpy as np
import pytest

from moving_car import CALIBRATION, MS, POINTS, car, expected, measured, messages, wall_scan
from runtime.base.errors import InputError
from runtime.geometry.rig import Rig
from stream_messages import add_up, image, push_pair


def push(stream, sensor, time_ms, **options):
    if sensor == "image":
        stream.push_image(image(time_ms // 50), time_ms * MS)
    elif sensor == "depth":
        stream.push_points(wall_scan(time_ms), time_ms * MS, **options)
    else:
        stream.push_pose(car(time_ms), time_ms * MS)


# --- reuse and poses -----------------------------------------------------------------------------


def test_a_camera_of_20_hz_and_a_lidar_of_10_hz_have_depth_in_every_answer(setup):
    made = setup(rig=Rig(calibration=CALIBRATION, pose_frame="lidar", scan_stamp="middle"))
    for time_ms, _, sensor in messages(until=1500):
        made.clock.advance_ms(time_ms - made.clock.now_ns() / MS)
        push(made.stream, sensor, time_ms)
        if sensor != "image":
            continue
        if time_ms % 100 and time_ms < 700:
            made.clock.advance_ms(50)  # the periods are not known yet
        result = next(made.stream)
        assert measured(result) == expected(time_ms)
        assert result.depth_reused == bool(time_ms % 100)
        if time_ms >= 700:
            assert result.age_ms == 0, "no scan is due for it"
    assert str(made.stream.state.level) == "OK"
    stages = made.stream.statistics.stages
    assert (stages["skew"].n, stages["depth_age"].n, stages["depth_age"].max_ms) == (15, 30, 50)


# --- poses ---------------------------------------------------------------------------------------


def test_poses_that_arrive_late_are_extrapolated_live_for_100_ms(setup):
    made = setup(rig=Rig(calibration=CALIBRATION, pose_frame="lidar", scan_stamp="middle"))
    for late_ms, fine in ((100, True), (101, False)):
        base = 1000 if fine else 1500
        for stamp in range(base, base + 200, 10):
            push(made.stream, "pose", stamp)
        at = base + 190 + late_ms
        made.stream.push_points(wall_scan(at - 20), (at - 20) * MS)
        made.stream.push_image(image(), at * MS)
        made.clock.advance_ms(50)
        result = next(made.stream)
        assert result.prediction.degraded == (() if fine else ("depth_uncompensated", "no_pose"))
        assert measured(result) == expected(at if fine else at - 20)


# --- bad input -----------------------------------------------------------------------------------


def test_poses_are_accounted_for(setup):
    made = setup(rig=Rig(calibration=CALIBRATION, pose_frame="lidar", scan_stamp="middle"))
    stream = made.stream
    for stamp in (0, 10, 10, 5, 2000, 30):
        push(stream, "pose", stamp)
    for bad in (np.eye(3), 2 * np.eye(4), None, np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="pose"):
            stream.push_pose(bad, 0)
    with pytest.raises(InputError, match="stamp"):
        stream.push_pose(np.eye(4), "now")
    with pytest.raises(InputError, match="times must"):
        stream.push_points(wall_scan(0), 0, np.zeros(POINTS - 1))
    stream.close()
    push(stream, "pose", 3000)
    poses = stream.counts.poses
    assert (poses.pushed, poses.answered, poses.pending) == (12, 4, 0)
    assert poses.dropped == {"duplicate": 1, "late": 1, "closed": 1}
    assert poses.errors == {"bad_message": 4, "bad_stamp": 1}
    assert stream.counts.errors == {"bad_message": 1}, "the scan"


# --- which frames -------------------------------------------------------------------------------


def test_a_live_push_never_waits_and_the_newest_complete_frame_wins(setup):
    made = setup()
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    for number in range(1, 100):
        push_pair(made.stream, number)
    made.predictor.gate.set()
    made.stream.close()
    counts = add_up(made.stream.counts)
    assert counts.images.answered + counts.images.dropped["unread"] == 2
    assert counts.images.dropped["overtaken"] == 98
    assert counts.dropped["overtaken"] == 2 * 98
    (result,) = list(made.stream)
    assert result.image_stamp == 9.9, "the newest answer, of the newest frame"


def test_a_complete_frame_is_not_overtaken_by_one_without_depth(setup):
    made = setup(max_wait_ms=50, rig=Rig(reuse_depth_ms=0))
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    push_pair(made.stream, 1)
    made.stream.push_image(image(2), 0.2)
    made.clock.advance_ms(50)
    made.stream.push_image(image(3), 0.3)  # decides that 0.2 stays alone
    made.predictor.gate.set()
    made.predictor.entered.acquire()
    dropped = add_up(made.stream.counts).images.dropped
    assert dropped["incomplete"] == 1
    assert "overtaken" not in dropped
    made.stream.close()
    assert next(made.stream).image_stamp == 0.3
