"""What a replay answers: matching, reuse, poses, flags and counts, by the stamps alone."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from car_poses import pose
from moving_car import (
    CALIBRATION,
    DEGRADED,
    INTRINSICS,
    MS,
    POINTS,
    TO_CAMERA,
    WALL_M,
    car,
    expected,
    measured,
    messages,
    wall_scan,
)
from runtime import InputError, Predictor, PushStream
from runtime import replay as answer_recording
from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import DEFAULT_RIG, Rig
from runtime.streams.stream_counter import StreamCounter
from stream_messages import add_up, depth, image

TIMES = ("latency_ms", "age_ms", "jitter_ms")  # differ in a live stream
POSED = Rig(calibration=CALIBRATION, pose_frame="lidar", scan_stamp="middle")


def message(sensor, time_ms):
    """Return the message that a sensor on the car sends at a time."""
    if sensor == "image":
        return "image", image(time_ms // 50), time_ms * MS
    if sensor == "depth":
        return "points", wall_scan(time_ms), time_ms * MS
    return "pose", car(time_ms), time_ms * MS


def pairs(count):
    """Messages of a camera and a LiDAR at 10 Hz, with depth maps."""
    for n in range(count):
        yield "image", image(n), n / 10
        yield "depth", depth(n), n / 10


def drive(**options):
    """The messages of a camera, a LiDAR and poses, see `messages`."""
    return [message(sensor, time_ms) for time_ms, _, sensor in messages(**options)]


@pytest.fixture
def replay(checked_predictor):
    """Replay messages: (answers, counts). Every message is accounted for."""

    def run(recording, rig=DEFAULT_RIG, *, predictor=None, **options):
        counter = StreamCounter()
        options = {"check_depth": False, "counter": counter} | options
        answers = answer_recording(predictor or checked_predictor(), recording, rig, **options)
        answers, counts = list(answers), add_up(counter.counts)
        assert (counts.pending, counts.images.answered) == (0, len(answers))
        return answers, counts

    return run


def image_ms(answers):
    return [answer.image_stamp // MS for answer in answers]


# --- integer stamps of another unit --------------------------------------------------------------


@pytest.mark.parametrize(("unit", "said"), [(1, False), (MS // 1000, True), (MS, True)])
def test_integer_stamps_of_another_unit_are_said(replay, unit, said):
    """Skew, age and motion would have no limits."""
    recording = [(*rest, stamp // unit) for *rest, stamp in drive(until=1000)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        replay(recording, POSED)
    assert any("apart are nanoseconds" in str(each.message) for each in caught) == said


# --- as the live stream --------------------------------------------------------------------------


def test_answers_are_those_of_the_engine_and_of_a_live_stream(model_file, make_frame, replay):
    recording = [
        message
        for number, (rgb, sparse_depth) in enumerate(make_frame(seed=seed) for seed in range(3))
        for message in (("image", rgb, number / 10), ("depth", sparse_depth, number * 100 * MS))
    ]
    with Predictor(model_file(), threads=1) as predictor:
        answers, counts = replay(recording, predictor=predictor, check_depth=True)
        with PushStream(predictor) as stream:
            for kind, array, stamp in recording:
                getattr(stream, f"push_{kind}")(array, stamp)
                if kind == "depth":
                    live = next(stream)
                    answer = answers[live.sequence]
                    assert answer.latency_ms == answer.prediction.latency.total_ms
                    for name in vars(answer).keys() - {"prediction", "rgb", *TIMES}:
                        assert getattr(answer, name) == getattr(live, name)
                    pair = [given for _, given, _ in recording[2 * live.sequence :][:2]]
                    expected = predictor.predict(*pair)
                    np.testing.assert_array_equal(answer.rgb, pair[0])
                    np.testing.assert_array_equal(live.rgb, pair[0])
                    for head, values in expected.heads.items():
                        np.testing.assert_array_equal(answer.prediction.heads[head], values)
                        np.testing.assert_array_equal(live.prediction.heads[head], values)
                    assert answer.prediction.degraded == live.prediction.degraded
        assert counts == stream.counts


def test_the_image_of_an_answer_is_read_only(replay):
    """The next check predicts from it; the array that was given is still the caller's."""
    given = image(0)
    ((answer,), _) = replay([("image", given, 0), ("depth", depth(0), 0)])
    with pytest.raises(ValueError, match="read-only"):
        answer.rgb[:] = 0
    np.testing.assert_array_equal(answer.rgb, given)
    given[:] = 0


# --- reuse and poses -----------------------------------------------------------------------------


@pytest.mark.parametrize("pose_frame", [None, "lidar"])
@pytest.mark.parametrize("times", [False, True])
def test_points_without_a_return_or_a_time_are_left_out_and_counted(replay, pose_frame, times):
    """The LiDAR is 1 m ahead of the camera, which would see (0, 0, 0) there, moved or not."""
    ahead = TO_CAMERA.copy()
    ahead[2, 3] = 1.0
    points = np.vstack([np.zeros((20, 3), np.float32), wall_scan(0)])
    after = np.zeros(len(points))
    after[:40:2] = 3.6, np.nan, *[3.6] * 18  # half of the marks, and ten of the wall
    scan = ("points", points, 0, after) if times else ("points", points, 0)
    poses = [("pose", car(time_ms), time_ms * MS) for time_ms in range(0, 200, 10)]
    recording = [("image", image(1), 0), scan, *(poses if pose_frame else ())]
    rig = replace(POSED, calibration=Calibration(INTRINSICS, ahead), pose_frame=pose_frame)
    (answer,), _ = replay(recording, rig)
    assert measured(answer) == pytest.approx(WALL_M + 1, abs=2e-3)
    assert answer.prediction.depth[16, 20] != 2, "1 m more than the mark"
    assert answer.prediction.cleaned.lost_points == (30 if times else 20)
    assert answer.prediction.degraded == (("points_untimed",) if times else ())


@pytest.mark.parametrize("pose_frame", [None, "lidar"])
def test_a_depth_map_cannot_be_moved(replay, pose_frame):
    recording = [("image", image(stamp), stamp * MS) for stamp in (0, 50, 110)]
    recording += [("depth", depth(stamp), stamp * MS) for stamp in (0, 100)]
    calibration = CALIBRATION if pose_frame else None
    rig = replace(POSED, calibration=calibration, pose_frame=pose_frame)
    answers, _ = replay(recording, rig)
    moved = ("depth_uncompensated",) if pose_frame else ()
    degraded = [answer.prediction.degraded for answer in answers]
    assert degraded == [(), ("depth_reused", "depth_uncompensated"), moved]


@pytest.mark.parametrize(
    ("options", "last_ms"), [({"reuse_depth_ms": 0}, 0), ({}, 150), ({"reuse_depth_ms": 500}, 500)]
)
def test_reuse_can_be_turned_off_and_ends_with_the_age(replay, options, last_ms):
    lost = {("depth", stamp) for stamp in range(100, 700, 100)}
    answers, _ = replay(drive(until=750, lost=lost), replace(POSED, **options))
    reused = [answer for answer in answers if answer.depth_reused]
    assert image_ms(reused) == list(range(50, last_ms + 1, 50))
    alone = [answer for answer in answers if "no_depth" in answer.prediction.degraded]
    assert image_ms(alone) == list(range(last_ms + 50, 700, 50)), "a LiDAR that stopped"


@pytest.mark.parametrize("frame", ["camera", "body"])
def test_poses_of_another_frame_of_the_car(replay, frame):
    body_from_lidar = pose((0.5, 0.2, 1.7), (0, 0.1, 0.3))
    calibration = Calibration(INTRINSICS, TO_CAMERA, body_from_lidar=body_from_lidar)
    mount = {"camera": TO_CAMERA, "body": body_from_lidar}[frame]
    recording = [("points", wall_scan(0), 0), ("image", image(), 40 * MS)]
    recording += [("pose", car(t) @ np.linalg.inv(mount), t * MS) for t in (0, 50)]
    (answer,), _ = replay(recording, replace(POSED, calibration=calibration, pose_frame=frame))
    assert measured(answer) == expected(40)


@pytest.mark.parametrize("as_floats", [True, False])
def test_a_scan_with_times_is_deskewed(replay, as_floats):
    """The last return was measured 100 ms after the first."""
    after_ms = np.linspace(0, 100, POINTS)
    scan = np.concatenate([wall_scan(t)[n : n + 1] for n, t in enumerate(after_ms)])
    times = after_ms / 1e3 if as_floats else (after_ms * MS).astype(np.uint64)
    recording = [("points", scan, 0, times), ("image", image(), 30 * MS)]
    recording += [message("pose", stamp) for stamp in range(0, 120, 10)]
    (answer,), _ = replay(recording, POSED)
    found = answer.prediction.depth[answer.prediction.depth > 1] - 1
    assert found == pytest.approx(WALL_M - 0.45, abs=2e-3)
    assert (answer.depth_motion, answer.prediction.degraded) == ("each", ())


@pytest.mark.parametrize(("scan_stamp", "stamp_ms"), [("start", 0), ("middle", 50), ("end", 100)])
def test_a_scan_is_moved_from_its_middle(replay, scan_stamp, stamp_ms):
    recording = [
        ("points", wall_scan(turn * 80 + 40), (stamp_ms * 8 // 10 + turn * 80) * MS)
        for turn in range(8)
    ]
    recording += [message("pose", stamp) for stamp in range(0, 800, 20)]
    recording.append(("image", image(), 600 * MS))
    (answer,), _ = replay(recording, replace(POSED, scan_stamp=scan_stamp))
    assert measured(answer) == expected(600)


TIMES_MS = range(0, 1500, 10)
JUMPED = [car(t) @ pose((3 * (t >= 960), 0, 0)) for t in TIMES_MS]
POSES = {
    "no_pose": [message("pose", t) for t in TIMES_MS if t < 500],
    "pose_gap": [message("pose", t) for t in TIMES_MS if not 800 < t < 1200],
    "pose_jump": [("pose", each, t * MS) for t, each in zip(TIMES_MS, JUMPED, strict=True)],
    "pose_clock": [("pose", car(t), (10**6 + t) * MS) for t in TIMES_MS],
}


@pytest.mark.parametrize("fault", POSES)
def test_a_pose_that_is_missing_is_a_flag_that_says_why(replay, fault):
    frame = ("points", wall_scan(940), 940 * MS), ("image", image(), 980 * MS)
    (answer,), _ = replay([*POSES[fault], *frame], POSED)
    assert answer.prediction.degraded == ("depth_uncompensated", fault)
    assert measured(answer) == expected(940), "as it is, not moved wrongly"
    assert answer.depth_motion == "none"


@pytest.mark.parametrize("late_ms", [
    {"depth": 180}, {"image": 180}, {"pose": 180}, {"depth": 90, "pose": 180}, {"depth": 400},
])  # fmt: skip
def test_answers_do_not_depend_on_how_late_a_sensor_was_recorded(replay, late_ms):
    """Positions of the poses, and which scan is reused."""
    recorded = messages(until=1500, lost={("depth", 400), ("pose", 640)})
    recorded.sort(key=lambda each: each[0] + late_ms.get(each[2], 0))
    recording = [message(sensor, time_ms) for time_ms, _, sensor in recorded]
    answers, counts = replay(recording, POSED)
    assert image_ms(answers) == list(range(0, 1500, 50))
    for answer in answers:
        time_ms = answer.image_stamp // MS
        assert measured(answer) == expected(time_ms)
        assert DEGRADED & {*answer.prediction.degraded} <= {"depth_reused"}
        assert answer.depth_stamp // MS == (300 if time_ms in (400, 450) else time_ms // 100 * 100)
    assert counts.reused == 16


def test_where_poses_end_answers_go_on_without_them(checked_predictor):
    """At most 16 frames wait for poses."""
    read = 0

    def recording():
        nonlocal read
        for time_ms, _, sensor in messages(until=4000, scan_ms=50):
            if sensor != "pose" or time_ms < 200:
                read = time_ms
                yield message(sensor, time_ms)

    times_ms, flagged = [], []
    for answer in answer_recording(checked_predictor(), recording(), POSED, check_depth=False):
        times_ms.append(answer.image_stamp // MS)
        flagged.append("no_pose" in answer.prediction.degraded)
        assert read <= times_ms[-1] + 18 * 50
    assert times_ms == list(range(0, 4000, 50))
    assert flagged == [time_ms > 290 for time_ms in times_ms]


# --- health --------------------------------------------------------------------------------------


def test_returns_are_held_out_with_the_option_consistency(replay):
    recording = [("image", image(), 0), ("depth", depth(), 0), ("image", image(1), 200 * MS)]
    (answer, camera_only), _ = replay(recording, consistency=0.5)
    assert 0.4 < answer.prediction.depth_returns / (32 * 40) < 0.6
    assert answer.consistency.holdout_error == 0, "0 + 1 m where 1 m was held out"
    assert answer.consistency.scale_error == 0
    assert camera_only.consistency is None
    (plain, _), _ = replay(recording)
    assert plain.prediction.depth_returns == 32 * 40
    assert plain.consistency is None


@pytest.mark.parametrize(("options", "flagged"), [
    ({"consistency": 0.05, "check_depth": True}, [True, True]),
    ({"check_depth": True}, [False, True]),
    ({"consistency": 0.05, "check_depth": False}, [False, False]),
    ({"check_depth": False}, [False, False]),
])  # fmt: skip
def test_depth_that_contradicts_the_image_is_reported(
    replay, checked_predictor, monkeypatch, options, flagged
):
    """With `consistency` the frame itself is flagged, otherwise the next one."""
    row, column = np.mgrid[:32, :40]
    seen = ((40 - row + column / 2) / 10).astype(np.float32)
    predictor = checked_predictor()

    def see(rgb, sparse_depth, predict=predictor.predict, **others):
        answer = predict(rgb, sparse_depth, **others)
        return answer if sparse_depth.any() else replace(answer, heads={"depth": seen})

    monkeypatch.setattr(predictor, "predict", see)
    recording = [
        each
        for stamp in (0.0, 0.1)
        for each in (("image", image(), stamp), ("depth", 10 * seen, stamp))
    ]
    answers, _ = replay(recording, predictor=predictor, **options)
    degraded = [answer.prediction.degraded for answer in answers]
    assert degraded == [("implausible_depth",) if each else () for each in flagged]


def test_returns_of_the_first_five_frames_are_checked_and_then_of_one_in_a_hundred(
    replay, checked_predictor
):
    predictor = checked_predictor()
    replay(pairs(206), predictor=predictor, check_depth=True)
    checks = [place for place, share in enumerate(predictor.shares) if not share]
    assert [place - n - 1 for n, place in enumerate(checks)] == [0, 1, 2, 3, 4, 104, 204]


# --- errors --------------------------------------------------------------------------------------


def test_frames_and_messages_that_are_errors_are_left_out_or_raised(replay, checked_predictor):
    recording = [
        ("image", image(), 0),
        ("depth", np.ones((32, 41), np.float32), 0),  # does not fit
        ("depth", depth(), "now"),
        ("image", image()[..., :2], 0.1),
        ("pose", np.eye(4), 0.1),  # without pose_frame
        ("points", np.zeros((5, 3), np.float32), 0.1),  # without a calibration
        ("image", image(2), 0.2),
        ("depth", depth(2), 0.2),
    ]
    errors = []
    (answer,), counts = replay(recording, on_error=errors.append)
    assert answer.image_stamp == 0.2
    parts = ["stamp must", "rgb must", "pose_frame=", "calibration=", "shape"]
    assert {type(error) for error in errors} == {InputError}
    assert {part for part in parts if any(part in str(error) for error in errors)} == set(parts)
    assert counts.images.errors == {"input_error": 1, "bad_message": 1}
    assert counts.depths.errors == {"input_error": 1, "bad_stamp": 1, "bad_message": 1}
    assert counts.poses.errors == {"bad_message": 1}
    for place in (2, 3, 4, 5):
        with pytest.raises(InputError):
            replay(recording[place : place + 1])
    with pytest.raises(InputError, match="shape"):
        replay(recording[:2])


@pytest.mark.parametrize(
    "bad",
    [None, (), ("image", image()), ["image", image(), 0], ("lidar", depth(), 0), (3, depth(), 0),
     ("image", image(), 0, None), ([], depth(), 0)],
)  # fmt: skip
def test_what_is_no_message_is_refused(replay, bad):
    with pytest.raises(InputError, match=r"a message must be a tuple .*image, depth, points, pose"):
        replay([bad], on_error=lambda error: None)
