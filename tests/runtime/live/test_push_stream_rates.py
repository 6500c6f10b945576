"""Sensors at different rates on a moving car: reuse, poses, and what each answer says about it."""

import random
import threading

import numpy as np
import pytest

from car_poses import pose
from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.live.watchdog import WatchdogLimits
from runtime.sync.outcome import Sensor
from stream_messages import add_up, depth, image

MS = 1_000_000
INTRINSICS = np.array([[30.0, 0, 20], [0, 30, 16], [0, 0, 1]])
#: The LiDAR looks ahead along x, its camera sits at the same place.
TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
CALIBRATION = Calibration(INTRINSICS, TO_CAMERA, (32, 40))
WALL_M, POINTS = 40.0, 135
DEGRADED = {"depth_reused", "depth_uncompensated", "no_pose", "pose_gap", "pose_jump", "pose_clock"}


def wall_scan(time_ms, *, speed=15.0):
    """A wall that stands across the road, as the LiDAR measures it at a time: float32 (N, 3)."""
    side, up = (axis.ravel() for axis in np.meshgrid(np.linspace(-9, 9, 15), np.linspace(-7, 7, 9)))
    distance = WALL_M - speed * time_ms / 1e3
    return np.stack([np.full(POINTS, distance), side, up], axis=1).astype(np.float32)


def car(time_ms, *, speed=15.0):
    return pose((speed * time_ms / 1e3, 0, 0))


def measured(result):
    """The depth of the returns that the predictor was given (it answers one more)."""
    found = result.prediction.depth[result.prediction.depth > 1] - 1
    return float(np.median(found)) if len(found) else None


def expected(time_ms):
    return pytest.approx(WALL_M - 0.015 * time_ms, abs=2e-3)


def messages(*, until, image_ms=50, scan_ms=100, pose_ms=10, lost=()):
    """(sensor, time) of a camera, a LiDAR and poses, in the order of time."""
    sensors = (("pose", pose_ms), ("depth", scan_ms), ("image", image_ms))
    return sorted(
        (time_ms, order, sensor)
        for order, (sensor, period) in enumerate(sensors)
        if period
        for time_ms in range(0, until, period)
        if (sensor, time_ms) not in lost
    )


def push(stream, sensor, time_ms, **options):
    if sensor == "image":
        stream.push_image(image(time_ms // 50), time_ms * MS)
    elif sensor == "depth":
        stream.push_points(wall_scan(time_ms), time_ms * MS, **options)
    else:
        stream.push_pose(car(time_ms), time_ms * MS)


def replay(made, pushed):
    """Push in one thread, and return the results."""

    def push_all():
        for time_ms, _, sensor in pushed:
            push(made.stream, sensor, time_ms)
        made.stream.close()

    pusher = threading.Thread(target=push_all)
    pusher.start()
    results = list(made.stream)
    pusher.join(60)
    return results


# --- reuse and poses -----------------------------------------------------------------------------


def test_a_camera_of_20_hz_and_a_lidar_of_10_hz_have_depth_in_every_answer(setup):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", max_wait_ms=20)
    results = replay(made, messages(until=1000))
    assert [result.image_stamp for result in results] == [t * MS for t in range(0, 1000, 50)]
    for result in results:
        time_ms = result.image_stamp // MS
        own = time_ms % 100 == 0
        assert measured(result) == expected(time_ms), time_ms
        assert result.prediction.degraded == (() if own else ("depth_reused",))
        assert (result.depth_reused, result.depth_motion) == (not own, "scan")
        assert result.depth_age_ms == -result.skew_ms == (0 if own else 50)
        assert result.depth_stamp == time_ms // 100 * 100 * MS
    counts = add_up(made.stream.counts)
    assert (counts.images.answered, counts.depths.answered) == (20, 10)
    assert (counts.camera_only, counts.reused) == (0, 10)
    assert (counts.poses.pushed, counts.poses.answered, counts.poses.pending) == (100, 100, 0)
    assert str(made.stream.state.level) == "OK"
    stages = made.stream.statistics.stages
    assert (stages["skew"].n, stages["depth age"].n, stages["depth age"].max_ms) == (10, 20, 50)


def test_live_too(setup):
    made = setup(mode="live", calibration=CALIBRATION, pose_frame="lidar")
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


def test_without_poses_the_scan_is_reused_as_it_is_and_says_so(setup):
    made = setup(mode="replay", calibration=CALIBRATION)
    results = replay(made, messages(until=400, pose_ms=0))
    for result in results:
        time_ms = result.image_stamp // MS
        assert measured(result) == expected(time_ms // 100 * 100)
        uncompensated = ("depth_reused", "depth_uncompensated") if time_ms % 100 else ()
        assert result.prediction.degraded == uncompensated
        assert result.depth_motion == "none"
    assert made.stream.state.reasons == ("degraded",)


@pytest.mark.parametrize("pose_frame", [None, "lidar"])
def test_a_depth_map_cannot_be_moved(setup, pose_frame):
    calibration = CALIBRATION if pose_frame else None
    made = setup(mode="replay", pose_frame=pose_frame, calibration=calibration)
    for stamp in (0, 50, 110):
        made.stream.push_image(image(stamp), stamp * MS)
    for stamp in (0, 100):
        made.stream.push_depth(depth(stamp), stamp * MS)
    made.stream.close()
    degraded = [result.prediction.degraded for result in made.stream]
    moved = ("depth_uncompensated",) if pose_frame else ()
    assert degraded == [(), ("depth_reused", "depth_uncompensated"), moved]


def test_reuse_can_be_turned_off_and_ends_with_the_age(setup):
    for options, last_ms in (({"reuse_depth_ms": 0}, 0), ({}, 150), ({"reuse_depth_ms": 500}, 500)):
        made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", **options)
        lost = {("depth", stamp) for stamp in range(100, 700, 100)}
        results = replay(made, messages(until=750, lost=lost))
        reused = [result.image_stamp // MS for result in results if result.depth_reused]
        assert reused == list(range(50, last_ms + 1, 50))
        alone = [r.image_stamp // MS for r in results if "no_depth" in r.prediction.degraded]
        assert alone == list(range(last_ms + 50, 700, 50)), "a LiDAR that stopped"


def test_an_answer_that_was_reused_and_not_fetched_is_counted(setup):
    made = setup(mode="live", calibration=CALIBRATION, max_wait_ms=0)
    push(made.stream, "image", 0)
    push(made.stream, "depth", 0)
    made.clock.advance_ms(1)
    next(made.stream)
    push(made.stream, "image", 50)
    push(made.stream, "image", 100)
    made.stream.close()
    counts = add_up(made.stream.counts)
    assert counts.camera_only + counts.reused + counts.depths.answered == counts.images.answered


def test_the_watchdog_counts_reused_results_apart(setup):
    limits = WatchdogLimits(reused=(2, 3))
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", watchdog=limits)
    lost = {("depth", 100)}
    results = replay(made, messages(until=200, lost=lost))
    assert [result.depth_reused for result in results] == [False, True, True, True]
    assert made.stream.state.reasons == ("reused",)


# --- poses ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", ["camera", "body"])
def test_poses_of_another_frame_of_the_car(setup, frame):
    body_from_lidar = pose((0.5, 0.2, 1.7), (0, 0.1, 0.3))
    calibration = Calibration(INTRINSICS, TO_CAMERA, body_from_lidar=body_from_lidar)
    mount = {"camera": TO_CAMERA, "body": body_from_lidar}[frame]
    made = setup(mode="replay", calibration=calibration, pose_frame=frame)
    made.stream.push_points(wall_scan(0), 0)
    made.stream.push_image(image(), 40 * MS)
    for stamp in (0, 50):
        made.stream.push_pose(car(stamp) @ np.linalg.inv(mount), stamp * MS)
    made.stream.close()
    assert measured(next(made.stream)) == expected(40)


def test_a_scan_with_times_is_deskewed(setup):
    """The last return was measured 100 ms after the first."""
    for as_floats in (True, False):
        made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar")
        after_ms = np.linspace(0, 100, POINTS)
        scan = np.concatenate([wall_scan(t)[n : n + 1] for n, t in enumerate(after_ms)])
        times = after_ms / 1e3 if as_floats else (after_ms * MS).astype(np.uint64)
        made.stream.push_points(scan, 0, times)
        made.stream.push_image(image(), 30 * MS)
        for stamp in range(0, 120, 10):
            push(made.stream, "pose", stamp)
        made.stream.close()
        result = next(made.stream)
        found = result.prediction.depth[result.prediction.depth > 1] - 1
        assert found == pytest.approx(WALL_M - 0.45, abs=2e-3)
        assert (result.depth_motion, result.prediction.degraded) == ("each", ())


@pytest.mark.parametrize(("scan_stamp", "stamp_ms"), [("start", 0), ("middle", 50), ("end", 100)])
def test_a_scan_is_moved_from_its_middle(setup, scan_stamp, stamp_ms):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", scan_stamp=scan_stamp)
    for turn in range(8):
        made.stream.push_points(wall_scan(turn * 80 + 40), (stamp_ms * 8 // 10 + turn * 80) * MS)
    for stamp in range(0, 800, 20):
        push(made.stream, "pose", stamp)
    made.stream.push_image(image(), 600 * MS)
    made.stream.close()
    assert measured(next(made.stream)) == expected(600)


@pytest.mark.parametrize("mode", ["live", "replay"])
@pytest.mark.parametrize("fault", ["no_pose", "pose_gap", "pose_jump", "pose_clock"])
def test_a_pose_that_is_missing_is_a_flag_that_says_why(setup, fault, mode):
    made = setup(mode=mode, calibration=CALIBRATION, pose_frame="lidar")
    far = pose((3, 0, 0))
    for stamp in range(0, 1500, 10):
        if fault == "pose_jump":
            made.stream.push_pose(car(stamp) @ (far if stamp >= 960 else np.eye(4)), stamp * MS)
        elif fault == "pose_clock":
            made.stream.push_pose(car(stamp), (10**6 + stamp) * MS)
        elif (fault == "no_pose" and stamp < 500) or (
            fault == "pose_gap" and not 800 < stamp < 1200
        ):
            push(made.stream, "pose", stamp)
    made.stream.push_points(wall_scan(940), 940 * MS)
    made.stream.push_image(image(), 980 * MS)
    made.clock.advance_ms(50)
    if mode == "replay":
        made.stream.close()
    result = next(made.stream)
    assert result.prediction.degraded == ("depth_uncompensated", fault)
    assert measured(result) == expected(940), "as it is, not moved wrongly"
    assert result.depth_motion == "none"
    made.stream.close()
    assert made.stream.state.reasons == ("degraded",)


def test_poses_that_arrive_late_are_extrapolated_live_for_100_ms(setup):
    made = setup(mode="live", calibration=CALIBRATION, pose_frame="lidar")
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


@pytest.mark.parametrize("turns", range(6))
def test_a_replay_with_poses_is_the_same_in_any_turns_of_three_threads(setup, turns):
    """Positions of the poses, and which scan is reused, never depend on the threads."""
    recording = messages(until=1500, lost={("depth", 400), ("pose", 640)})
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", max_wait_ms=5)
    chance = random.Random(turns)
    pauses = {sensor: chance.choice([0, 0, 0.001]) for sensor in ("image", "depth", "pose")}

    def push_all(sensor):
        for time_ms, _, of in recording:
            if of == sensor:
                push(made.stream, sensor, time_ms)
                if pauses[sensor]:
                    threading.Event().wait(chance.random() * pauses[sensor])

    pushers = [threading.Thread(target=push_all, args=(sensor,)) for sensor in pauses]

    def close_after_all():
        for pusher in pushers:
            pusher.join()
        made.stream.close()

    for thread in (*pushers, threading.Thread(target=close_after_all)):
        thread.start()
    results = list(made.stream)
    assert [result.image_stamp // MS for result in results] == list(range(0, 1500, 50))
    for result in results:
        time_ms = result.image_stamp // MS
        assert measured(result) == expected(time_ms)
        assert DEGRADED & {*result.prediction.degraded} <= {"depth_reused"}
        assert result.depth_stamp // MS == (300 if time_ms in (400, 450) else time_ms // 100 * 100)
    assert add_up(made.stream.counts).reused == 16


def test_a_replay_whose_poses_end_pauses_once_and_goes_on(setup):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar", max_wait_ms=5)
    done = threading.Event()

    def push_all():
        for time_ms, _, sensor in messages(until=4000, scan_ms=50):
            if sensor != "pose" or time_ms < 200:
                push(made.stream, sensor, time_ms)
        done.set()
        made.clock.notify()

    results = []
    pusher = threading.Thread(target=push_all)
    reader = threading.Thread(target=lambda: results.extend(made.stream))
    pusher.start()
    reader.start()
    assert made.clock.holds_up(
        pusher,
        made.stream._changed,
        still=lambda: made.stream._synchronizer.full(Sensor.DEPTH) and not made.stream._ready,
        ended=done.is_set,
    )
    made.clock.advance_ms(2000)
    assert done.wait(60)
    made.stream.close()
    reader.join(60)
    pusher.join(60)
    assert len(results) == 80
    flagged = ["no_pose" in result.prediction.degraded for result in results]
    assert flagged == [time_ms > 290 for time_ms in range(0, 4000, 50)]


def test_poses_far_ahead_of_a_replay_wait_for_it(setup):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar")
    done = threading.Event()

    def push_poses():
        for number in range(5000):
            made.stream.push_pose(np.eye(4), number * 10 * MS)
        done.set()
        made.clock.notify()

    pusher = threading.Thread(target=push_poses)
    pusher.start()
    assert made.clock.holds_up(pusher, made.stream._changed, ended=done.is_set)
    assert made.stream.counts.poses.pushed == 4097
    made.stream.push_points(wall_scan(0), 20_000 * MS)
    made.stream.push_image(image(), 20_000 * MS)
    assert measured(next(made.stream)) == expected(0)
    assert done.wait(60)
    pusher.join(60)


# --- bad input -----------------------------------------------------------------------------------


def test_poses_are_accounted_for(setup):
    made = setup(mode="live", calibration=CALIBRATION, pose_frame="lidar")
    stream = made.stream
    for stamp in (0, 10, 10, 5, 2000, 30):
        push(stream, "pose", stamp)
    for bad in (np.eye(3), 2 * np.eye(4), None, np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match="pose"):
            stream.push_pose(bad, 0)
    with pytest.raises(InputError, match="stamp"):
        stream.push_pose(np.eye(4), "now")
    stream.close()
    push(stream, "pose", 3000)
    poses = stream.counts.poses
    assert (poses.pushed, poses.answered, poses.pending) == (12, 4, 0)
    assert poses.dropped == {"duplicate": 1, "late": 1, "closed": 1}
    assert poses.errors == {"bad_message": 4, "bad_stamp": 1}
    assert stream.counts.pushed == 0, "of the images and depth maps"


def test_a_pose_may_be_changed_after_it_was_pushed(setup):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar")
    buffer = np.eye(4)
    for stamp in (0, 50):
        buffer[0, 3] = 0.015 * stamp
        made.stream.push_pose(buffer, stamp * MS)
    made.stream.push_points(wall_scan(0), 0)
    made.stream.push_image(image(), 40 * MS)
    made.stream.close()
    assert measured(next(made.stream)) == expected(40)


@pytest.mark.parametrize(("options", "names"), [
    ({"pose_frame": "wheel", "calibration": CALIBRATION}, "pose_frame"),
    ({"pose_frame": 3, "calibration": CALIBRATION}, "pose_frame"),
    ({"pose_frame": "lidar"}, "calibration="),
    ({"pose_frame": "body", "calibration": CALIBRATION}, "body_from_lidar"),
    ({"scan_stamp": "first"}, "scan_stamp"), ({"reuse_depth_ms": -1}, "reuse_depth_ms"),
    ({"reuse_depth_ms": "x"}, "reuse_depth_ms"),
])  # fmt: skip
def test_options_out_of_range(setup, options, names):
    with pytest.raises(InputError, match=names):
        setup(**options)


def test_poses_need_the_option_pose_frame(setup):
    stream = setup().stream
    with pytest.raises(InputError, match="pose_frame="):
        stream.push_pose(np.eye(4), 0)
    assert stream.counts.poses.errors == {"bad_message": 1}


@pytest.mark.parametrize("times", [
    [0.0] * POINTS, np.zeros(14), np.zeros((POINTS, 1)), np.full(POINTS, np.nan),
    np.full(POINTS, 1.5), np.full(POINTS, 5000 * MS), np.full(POINTS, 2**63, np.uint64),
    np.zeros(POINTS, bool), np.zeros(POINTS, "U3"),
])  # fmt: skip
def test_times_that_are_none_are_refused(setup, times):
    stream = setup(calibration=CALIBRATION).stream
    with pytest.raises(InputError, match="times must"):
        stream.push_points(wall_scan(0), 0, times)
    assert add_up(stream.counts).depths.errors == {"bad_message": 1}


def test_a_scan_without_points_has_no_times(setup):
    made = setup(mode="replay", calibration=CALIBRATION, pose_frame="lidar")
    made.stream.push_points(np.zeros((0, 3), np.float32), 0, np.zeros(0))
    made.stream.push_image(image(), 0)
    push(made.stream, "pose", 0)
    made.stream.close()
    assert next(made.stream).prediction.degraded == ("no_depth",)
