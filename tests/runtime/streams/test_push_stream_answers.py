"""What an answer of the stream carries, and what its statistics and watchdog say."""

import threading

import numpy as np

from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from stream_messages import depth, image, push_pair


def test_latency_age_and_deadline(setup):
    now = iter([1.0, 2.5])
    made = setup(deadline_ms=30, sensor_clock=lambda: next(now))
    made.predictor.takes_ms = 30
    push_pair(made.stream, 0)
    first = next(made.stream)
    made.predictor.takes_ms = 30.001
    push_pair(made.stream, 10)
    second = next(made.stream)
    assert (first.latency_ms, first.age_ms, first.deadline_met) == (30, 1000, True)
    assert (second.latency_ms, second.age_ms, second.deadline_met) == (30.001, 1500, False)
    statistics, stages = made.stream.statistics, made.stream.statistics.stages
    assert [stages[of].n for of in ("latency", "age", "skew", "predict", "jitter")] == [2] * 4 + [1]
    assert (stages["age"].mean_ms, statistics.missed.count) == (1250, 1)


def test_pushed_arrays_may_be_reused_afterwards(setup):
    made = setup()
    made.predictor.gate.clear()
    rgb, sparse_depth = image(3), depth(3)
    made.stream.push_image(rgb, 0)
    made.stream.push_depth(sparse_depth, 0)
    rgb[:], sparse_depth[:] = 0, 0
    made.predictor.gate.set()
    result = next(made.stream)
    assert (result.rgb == image(3)).all()
    assert (result.prediction.depth == depth(3) + 1).all()


def test_the_watchdog_reports_changes_and_its_present_state(setup):
    reported, heard = [], threading.Semaphore(0)

    def hear(state):
        reported.append((str(state.level), state.reasons))
        heard.release()

    made = setup(deadline_ms=30, on_state=hear)
    assert str(made.stream.state.level) == "n/a"
    push_pair(made.stream, 0)
    next(made.stream)
    made.predictor.takes_ms = 31
    push_pair(made.stream, 1)
    next(made.stream)
    for _ in range(2):
        assert heard.acquire(timeout=60)
    made.clock.advance_ms(500)
    assert heard.acquire(timeout=60)
    made.predictor.gate.clear()
    push_pair(made.stream, 2)
    made.clock.advance_ms(2000)
    assert str(made.stream.state.level) == "ERROR", "while the worker hangs"
    made.predictor.gate.set()
    made.predictor.takes_ms = 0
    made.stream.close()
    silent = ("silence_ms", "camera_silent", "lidar_silent")
    assert reported[:3] == [("OK", ()), ("WARN", ("late",)), ("WARN", ("late", *silent))]


# --- health and calibration --------------------------------------------------------------------


def test_a_frozen_camera_and_a_lost_sector_are_flagged(setup):
    made = setup(on_state=lambda state: None)
    whole = np.random.default_rng(0).uniform(1, 50, (32, 40)).astype(np.float32)
    sector = whole.copy()
    sector[:, :10] = 0
    for number in range(8):
        made.stream.push_image(image(min(number, 6)), number / 10)
        made.stream.push_depth(whole if number < 6 else sector, number / 10)
        if number < 7:
            next(made.stream)
    assert next(made.stream).health == ("image_frozen", "lidar_sector_lost")
    assert made.stream.state.reasons == ("degraded",)


def test_points_are_projected_and_the_focal_length_is_the_cameras(setup):
    intrinsics = np.array([[30.0, 0, 20], [0, 30, 16], [0, 0, 1]])
    made = setup(rig=Rig(calibration=Calibration(intrinsics, np.eye(4), (32, 40))))
    points = np.array([[0, 0, 10, 0.5], [2, 0, 10, 0.5], [0, 0, -3, 0.5]], np.float32)
    made.stream.push_image(image(), 0)
    made.stream.push_points(points, 0)
    points[:] = 1
    result = next(made.stream)
    expected = np.ones((32, 40), np.float32)
    expected[16, [20, 26]] = 11
    np.testing.assert_array_equal(result.prediction.depth, expected)
    made.predictor.focal_length_px = 50.0
    push_pair(made.stream, 1)
    next(made.stream)
    assert made.predictor.focal_lengths_px == [30, 50], "the predictor's own comes first"


def test_returns_are_checked_after_their_result_and_in_no_latency(setup):
    seen = []
    made = setup(check_depth=True, on_result=lambda r: seen.append(len(made.predictor.shares)))
    made.predictor.takes_ms = 10
    push_pair(made.stream, 0)
    made.stream.close()
    assert (seen, made.predictor.shares) == ([1], [1, 0])
    assert made.stream.statistics.stages["latency"].max_ms == 10
