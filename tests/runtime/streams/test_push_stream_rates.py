"""Sensors at different rates on a moving car: reuse, poses, and what each answer says about it."""

import numpy as np
import pytest

from moving_car import CALIBRATION, MS, POINTS, car, expected, measured, messages, wall_scan
from runtime.base.errors import InputError
from runtime.geometry.rig import Rig
from stream_messages import image


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
