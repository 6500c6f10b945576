"""Moving returns to one time, against a slow loop with scipy's rotations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from car_poses import DAY_NS, MS, drive, pose
from runtime.base.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.geometry.motion import compensate_points, lidar_mount, point_times, project_compensated
from runtime.geometry.poses import PoseFrame, PoseTrack
from runtime.streams.frame import Frame
from runtime.streams.messages import Image, Scan

INTRINSICS = np.array([[60.0, 0, 40], [0, 60, 20], [0, 0, 1]])
TO_CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])
CALIBRATION = Calibration(INTRINSICS, TO_CAMERA, (40, 80))


def by_a_slow_loop(points, times_ns, poses, stamps_ns, to_ns, mount):
    """Each point by scipy's slerp and a straight line between the two poses beside its time."""
    start = stamps_ns[0]
    seconds = (np.array(stamps_ns) - start) / 1e9
    slerp = Slerp(seconds, Rotation.from_matrix([each[:3, :3] for each in poses]))
    positions = np.array([each[:3, 3] for each in poses])

    def to_world(point, time_ns, *, inverse=False):
        at = (int(time_ns) - start) / 1e9
        turn = slerp([at])[0]
        place = np.array([np.interp(at, seconds, positions[:, axis]) for axis in range(3)])
        on_car = Rotation.from_matrix(mount[:3, :3])
        if inverse:
            return on_car.inv().apply(turn.inv().apply(point - place) - mount[:3, 3])
        return turn.apply(on_car.apply(point) + mount[:3, 3]) + place

    moved = points.astype(np.float64)
    for number, point in enumerate(points[:, :3].astype(np.float64)):
        moved[number, :3] = to_world(to_world(point, times_ns[number]), to_ns, inverse=True)
    return moved


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 30),
    start_ns=st.sampled_from([0, -DAY_NS, 20_000 * DAY_NS]),
    turn=st.floats(0.01, 1.5),
)
def test_each_return_is_moved_by_the_pose_at_its_own_time(seed, count, start_ns, turn):
    rng = np.random.default_rng(seed)
    poses, stamps = drive(30, turn=turn, start_ns=start_ns)
    mount = pose(rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3))
    points = rng.uniform(-60, 60, (count, 4)).astype(np.float32)
    times = rng.integers(stamps[0], stamps[-1], count, endpoint=True)
    to = int(rng.integers(stamps[0], stamps[-1]))
    track = PoseTrack.of(poses, stamps).mounted(mount)
    before = points.copy()
    moved = compensate_points(points, times, track, to)
    expected = by_a_slow_loop(points, times, poses, stamps, to, mount)
    assert moved.dtype == np.float32
    # 36 µs of rounded times at 15 m/s and 1.5 rad/s of 100 m.
    np.testing.assert_allclose(moved, expected, atol=8e-3)
    np.testing.assert_array_equal(moved[:, 3], points[:, 3])
    np.testing.assert_array_equal(points, before)


def test_a_world_far_away_costs_no_precision():
    poses, stamps = drive(30)
    points = np.array([[10, 0, 0], [0, 80, 1]], np.float32)
    near = compensate_points(points, 0, PoseTrack.of(poses, stamps), 200 * MS)
    far = [pose((4.5e6, 5.4e6, 200)) @ each for each in poses]
    np.testing.assert_allclose(
        compensate_points(points, 0, PoseTrack.of(far, stamps), 200 * MS), near, atol=1e-4
    )


def test_returns_that_are_not_finite_stay_so_and_other_arrays_are_refused():
    track = PoseTrack.of(*drive(30))
    points = np.array([[np.nan, 1, 2], [np.inf, 0, 0], [3e38, 3e38, 0], [1, 1, 1]], np.float32)
    moved = compensate_points(points, np.arange(4) * MS, track, 200 * MS)
    assert np.isfinite(moved).all(axis=1).tolist() == [False, False, False, True]
    with pytest.raises(InputError, match="points"):
        compensate_points(np.zeros((3, 2), np.float32), 0, track, 0)


def test_a_scan_is_projected_where_the_picture_sees_it():
    """10 m ahead, 100 ms later at 15 m/s: 8.5 m; as one, and each by its own time."""
    poses, stamps = drive(30, turn=1e-9)
    track = PoseTrack.of(poses, stamps)
    points = np.array([[10.3, 0, -0.1], [-5, 0, 0]], np.float32)
    for times in (0, np.zeros(2, np.int64)):
        for to, ahead in ((100 * MS, 8.5), (250 * MS, 6.25)):  # the motion is not the mount
            depth = project_compensated(CALIBRATION, points, times, track, to, (40, 80))
            assert np.count_nonzero(depth) == 1
            assert depth.max() == pytest.approx(ahead, abs=1e-3)
    with pytest.raises(InputError, match="calibration"):
        project_compensated(CALIBRATION, points, 0, track, 0, (40, 81))


@pytest.mark.parametrize(
    ("odd", "shift_m"), [(None, -0.3), (None, 2.9), (np.nan, -0.3), (np.inf, -0.3)]
)
def test_only_what_no_time_brings_before_the_camera_is_left_out(odd, shift_m):
    """While the car turns around: many returns come before the camera by moving them alone.

    Returns behind the LiDAR are before a camera that is behind it.
    """
    to_camera = TO_CAMERA.copy()
    to_camera[2, 3] = shift_m
    calibration = Calibration(INTRINSICS, to_camera, (40, 80))
    rng = np.random.default_rng(0)
    track = PoseTrack.of(*drive(200, turn=1.5))
    points = rng.uniform((-40, -40, -4), (40, 40, 4), (20_000, 3)).astype(np.float32)
    if odd is not None:
        points[::7, 1] = odd
    times = rng.integers(0, 1900 * MS, len(points))
    for to in (50 * MS, 500 * MS):
        whole = calibration.project(compensate_points(points, times, track, to), (40, 80))
        assert np.count_nonzero(whole) > 1000
        depth = project_compensated(calibration, points, times, track, to, (40, 80))
        np.testing.assert_array_equal(depth, whole)


def test_mounts_are_those_of_the_calibration():
    body = pose((1, 0, 2), (0, 0, 0.1))
    calibration = Calibration(INTRINSICS, TO_CAMERA, body_from_lidar=body)
    mounts = {PoseFrame.LIDAR: np.eye(4), PoseFrame.CAMERA: TO_CAMERA, PoseFrame.BODY: body}
    for frame, mount in mounts.items():
        np.testing.assert_array_equal(lidar_mount(frame, calibration), mount)
    with pytest.raises(InputError, match="body_from_lidar"):
        lidar_mount(PoseFrame.BODY, CALIBRATION)


@pytest.mark.parametrize("stamp_ns", [20_000 * DAY_NS, -DAY_NS])
def test_times_of_points_are_seconds_after_the_stamp_or_nanoseconds_of_its_clock(stamp_ns):
    after = [0, 5 * MS, -100 * MS]
    points = np.ones((3, 3), np.float32)
    for times in (np.array(after) / 1e9, np.array(after, np.int64) + stamp_ns):
        scan = Scan.of(points, point_times(times, 3, stamp_ns), stamp_ns)
        assert scan.times.tolist() == [stamp_ns + each for each in after]
        assert (scan.lost, scan.untimed) == (0, False)
    for wrong in (np.array([0, 2, 1.5]), np.array([0, -2000, 2000]) * MS + stamp_ns, [0, 0, 0]):
        with pytest.raises(InputError, match="times"):
            Scan.of(points, point_times(wrong, 3, stamp_ns), stamp_ns)


@pytest.mark.parametrize("kind", ["f4", "f8", "i8", "u8"])
def test_a_point_without_return_and_a_return_without_time_cost_themselves(kind):
    """A time of any type is checked after its conversion; those of lost points are not."""
    points = np.float32([[5, 0, 0], [0, 0, 0], [np.nan, 1, 1], [6, 0, 0], [7, 0, 0], [8, 0, 0]])
    times = np.array([0, 3.6, 99, 3.6, 0.05, 0])
    if kind[0] != "f":
        times = DAY_NS + times * 1e9
    scan = Scan.of(points, point_times(times.astype(kind), 6, DAY_NS), DAY_NS)
    np.testing.assert_array_equal(scan.points[:, 0], [5, 7, 8])
    np.testing.assert_allclose(scan.times - DAY_NS, [0, 50 * MS, 0], atol=10)
    assert (scan.lost, scan.untimed) == (3, True)
    image = Image(np.zeros((40, 80, 3), np.uint8))
    depth = Frame(image, scan, calibration=CALIBRATION).compensated
    assert (depth.degraded, depth.lost_points) == (("points_untimed",), 3)
    only_lost = Scan.of(points[:3], point_times(times[:3].astype(kind), 3, DAY_NS), DAY_NS)
    assert (only_lost.lost, only_lost.untimed) == (2, False)
