"""The pose buffer: interpolation against scipy, extrapolation, gaps, jumps, and any sequence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from car_poses import DAY_NS, MS, drive, pose
from runtime.base.errors import InputError
from runtime.geometry.poses import NoPoseError, PoseBuffer, PoseTrack
from runtime.geometry.rigid import nearest_rigid


def filled(poses, stamps, **options):
    buffer = PoseBuffer(**options)
    for each, stamp in zip(poses, stamps, strict=True):
        assert buffer.add(nearest_rigid("pose", each), stamp)
    return buffer


def at(buffer, *times_ns):
    times = np.array(times_ns, np.int64)
    return buffer.between(int(times.min()), int(times.max())).at(times)


def reason(buffer, *times_ns):
    with pytest.raises(NoPoseError) as caught:
        at(buffer, *times_ns)
    assert caught.value.reason in str(caught.value)
    return caught.value.reason


angles = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
places = st.tuples(*[st.floats(-3, 3)] * 3)


@settings(max_examples=50, deadline=None)
@given(rotvecs=st.lists(angles, min_size=2, max_size=6), data=st.data())
def test_between_poses_it_is_scipys_slerp_and_a_straight_line(rotvecs, data):
    positions = [data.draw(places) for _ in rotvecs]
    stamps = DAY_NS + np.cumsum([data.draw(st.integers(1, 250)) for _ in rotvecs]) * MS
    turns, jumped = Rotation.from_rotvec(rotvecs).as_quat(), np.zeros(len(stamps), bool)
    track = PoseTrack(stamps, turns[:, [3, 0, 1, 2]], np.array(positions), jumped, np.eye(4))
    times = np.array([data.draw(st.integers(int(stamps[0]), int(stamps[-1]))) for _ in range(5)])
    seconds = (stamps - DAY_NS) / 1e9
    expected = Slerp(seconds, Rotation.from_rotvec(rotvecs))((times - DAY_NS) / 1e9).as_matrix()
    found = track.at(times)
    np.testing.assert_allclose(found[:, :3, :3], expected, atol=1e-6)
    for axis in range(3):
        line = np.interp((times - DAY_NS) / 1e9, seconds, np.array(positions)[:, axis])
        np.testing.assert_allclose(found[:, axis, 3], line, atol=1e-6)


def test_poses_come_back_as_they_were_added():
    poses, stamps = drive(200, start_ns=DAY_NS)
    np.testing.assert_allclose(at(filled(poses, stamps), *stamps), poses, atol=1e-9)


@pytest.mark.parametrize("rotvec", [(np.pi, 0, 0), (0, np.pi, 0), (0, 0, np.pi), (2, 2, 0.5)])
def test_half_turns_have_a_quaternion(rotvec):
    only = pose((1, 2, 3), rotvec)
    np.testing.assert_allclose(at(filled([only], [5]), 5), [only], atol=1e-9)


def test_beyond_the_ends_the_motion_goes_on_for_100_ms():
    poses, stamps = drive(60)
    truth, _ = drive(80)
    buffer = filled(poses, stamps)
    found = at(buffer, stamps[-1] + 100 * MS)
    assert np.linalg.norm(found[0, :3, 3] - truth[69][:3, 3]) < 0.08, "7.5 m/s² for 0.1 s"
    np.testing.assert_allclose(found[0, :3, :3], truth[69][:3, :3], atol=1e-3)
    assert reason(buffer, stamps[-1] + 100 * MS + 1) == "no_pose"
    assert np.linalg.norm(at(buffer, -100 * MS)[0, :3, 3] - (-1.5, 0.0375, 0)) < 0.08
    assert reason(buffer, -100 * MS - 1) == "no_pose"


@pytest.mark.parametrize(("gap_ms", "known"), [(250, True), (260, False)])
def test_a_gap_longer_than_the_limit_has_no_pose(gap_ms, known):
    left = [each for each in zip(*drive(60), strict=True) if not 0 < each[1] / MS - 200 < gap_ms]
    gone = filled(*zip(*left, strict=True))
    if known:
        assert len(at(gone, 300 * MS)) == 1
    else:
        assert reason(gone, 300 * MS) == "pose_gap"
    assert len(at(gone, 150 * MS, 500 * MS)) == 2, "both ends are known"


@pytest.mark.parametrize("far", [pose((2, 0, 0)), pose((0, 0, -1)), pose(rotvec=(0, 0, 0.3))])
def test_a_jump_of_the_odometry_is_found_and_nothing_is_moved_over_it(far):
    poses, stamps = drive(100)
    poses[50:] = [each @ far for each in poses[50:]]
    buffer = filled(poses, stamps)
    assert reason(buffer, 495 * MS) == "pose_jump"
    assert reason(buffer, 400 * MS, 600 * MS) == "pose_jump"
    assert len(at(buffer, 300 * MS, 490 * MS)) == 2
    assert len(at(buffer, 500 * MS, 600 * MS)) == 2


@pytest.mark.parametrize("step_ms", [1, 10, 100])
def test_a_hard_drive_with_noise_is_no_jump(step_ms):
    rng = np.random.default_rng(0)
    poses, stamps = drive(1000 // step_ms, step_ms=step_ms, speed=20, turn=0.5)
    for each in poses:
        each[:3, 3] += rng.normal(0, 0.02, 3)
    assert len(at(filled(poses, stamps), *stamps)) == len(stamps)


def test_an_empty_buffer_and_another_clock_say_so():
    assert reason(PoseBuffer(), 5) == "no_pose"
    poses, stamps = drive(10, start_ns=DAY_NS)
    assert reason(filled(poses, stamps), 5) == "pose_clock"
    assert reason(filled(poses, stamps), 2 * DAY_NS) == "pose_clock"
    assert len(PoseBuffer().whole().at(np.zeros(0, np.int64))) == 0


def test_duplicates_and_late_poses_are_not_taken_and_a_new_clock_is():
    buffer = filled(*drive(10, start_ns=DAY_NS))
    newest = buffer.newest_ns
    assert not buffer.add(pose(), newest)
    assert not buffer.add(pose(), newest - 1)
    assert buffer.newest_ns == newest
    assert buffer.add(pose(), 0)
    assert buffer.newest_ns == 0
    assert reason(buffer, newest) == "pose_clock", "the poses of the other clock are forgotten"


def test_memory_is_bounded():
    buffer = filled(*drive(100), capacity=16)
    assert 16 <= len(buffer.whole().stamps_ns) < 34, "with both extrapolations"
    assert len(at(buffer, 900 * MS, 990 * MS)) == 2


@pytest.mark.parametrize("bad", [
    None, np.eye(3), np.eye(4, dtype=int), np.full((4, 4), np.nan), pose((1e9, 0, 0)),
    np.ma.masked_array(np.eye(4)), pose((1, 2, 3)).T,
])  # fmt: skip
def test_a_pose_that_is_not_rigid_is_refused(bad):
    with pytest.raises(InputError, match="pose"):
        PoseTrack.of([bad], [0])


def test_a_recording_has_a_later_stamp_for_each_pose():
    poses, stamps = drive(5)
    assert len(PoseTrack.of(poses, stamps).stamps_ns) == 7, "with both extrapolations"
    of_one = ((None, [0]), ([np.eye(4)], [0, 1]))
    wrong = ([0] * 5, [10**12, *stamps[1:]], [*stamps[:4], np.nan], [*stamps[:4], 2**63])
    for case in (*of_one, *((poses, each) for each in wrong)):
        with pytest.raises(InputError, match="stamp"):
            PoseTrack.of(*case)


def test_a_mounted_frame_moves_with_the_car():
    poses, stamps = drive(5)
    mount = pose((1, 0, 2), (0, 0.2, 0))
    found = PoseTrack.of(poses, stamps).mounted(mount).at(np.array(stamps))
    np.testing.assert_allclose(found, np.array(poses) @ mount, atol=1e-9)


steps = st.one_of(st.integers(-300, 300), st.integers(-(10**5), 10**5))
messages = st.lists(st.tuples(steps, places, angles), max_size=40)


@settings(max_examples=60, deadline=None)
@given(messages=messages, times=st.lists(st.integers(-400, 400), min_size=1, max_size=5))
def test_any_sequence_has_rigid_poses_or_a_reason(messages, times):
    buffer = PoseBuffer(capacity=8)
    stamp = 0
    for step, position, rotvec in messages:
        stamp += step
        buffer.add(pose(position, rotvec), stamp * MS)
    queried = (np.array(times, np.int64) + (stamp if messages else 0)) * MS
    track = buffer.between(int(queried.min()), int(queried.max()))
    assert (np.diff(track.stamps_ns) > 0).all()
    why, found = None, np.zeros((0, 4, 4))
    try:
        found = track.at(queried)
    except NoPoseError as error:
        why = error.reason
    assert why in {None, "no_pose", "pose_gap", "pose_jump", "pose_clock"}
    for each in found:
        nearest_rigid("pose", each)
