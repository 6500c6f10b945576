"""What the benchmarks of motion count, on a road of planes and a stream of a few seconds."""

from dataclasses import replace

import numpy as np
import pytest

import motion
import soak_rates
from motion import car_pose, moving_cars, sweep_errors, swept_scan
from runtime import Predictor
from runtime.io.calibration import Calibration


def test_a_scan_of_a_car_that_stands_is_the_street():
    points, times, places = swept_scan(lambda time_s: car_pose(0, speed=0, turn=0))
    np.testing.assert_allclose(points + np.array([0, 0, 1.73]), places, atol=1e-5)
    assert (times.min(), times.max()) == (0, round(1799 * 1e8 / 1800))
    on_a_plane = [np.abs(places @ normal - d) < 1e-6 for normal, d in motion.PLANES]
    assert np.any(on_a_plane, axis=0).all()


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_deskewing_is_exact_to_a_millimetre_and_needed(turn):
    errors = sweep_errors(speed=15, turn=turn)
    assert np.percentile(errors["each by its own time"][:, 1], 95) < 1e-3
    assert np.percentile(errors["as they are"][:, 1], 50) > 0.05


def test_a_car_moves_where_its_returns_do_not_lie_where_poses_put_them():
    calibration = Calibration(
        np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]]), soak_rates.CALIBRATION.extrinsics
    )
    cars = np.zeros((64, 96), bool)
    cars[20:44, 30:66] = True
    frame = motion.DriveFrame(
        np.zeros((64, 96, 3), np.uint8), soak_rates.scan(0), np.ones((64, 96), np.float32), cars,
        np.eye(4), calibration,
    )  # fmt: skip
    assert not moving_cars(frame, frame.points).any()
    farther = frame.points + np.array([0.5, 0, 0], np.float32)
    np.testing.assert_array_equal(moving_cars(frame, farther), cars)
    assert not moving_cars(replace(frame, cars=~cars & False), farther).any()


def test_a_short_soak_of_three_rates_finds_nothing_wrong():
    with Predictor("ssdnet-nano", threads=1) as predictor:
        found, report = soak_rates.soak_rates(predictor, seconds=3, seed=0)
    assert found == []
    assert "depth_reused" in report


def test_the_soak_finds_returns_that_were_not_moved(monkeypatch):
    monkeypatch.setattr(soak_rates, "pose", lambda time_s: np.eye(4))
    with Predictor("ssdnet-nano", threads=1) as predictor:
        found, _ = soak_rates.soak_rates(predictor, seconds=3, seed=0)
    assert any("m off at" in problem for problem in found)


def test_the_soak_finds_a_flag_without_a_reason(monkeypatch):
    monkeypatch.setattr(soak_rates, "REACH_S", 100.0)
    monkeypatch.setattr(soak_rates, "phase", lambda time_s: "on time" if time_s < 1 else "none")
    monkeypatch.setattr(soak_rates, "PHASES", ("on time", "none", "none"))
    with Predictor("ssdnet-nano", threads=1) as predictor:
        found, _ = soak_rates.soak_rates(predictor, seconds=3, seed=0)
    assert any("no_pose at" in problem for problem in found)
