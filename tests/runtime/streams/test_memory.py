from itertools import pairwise

import cv2
import numpy as np
import pytest

from drive_to_wall import CALIBRATION, PERIOD_NS, SIZE, pose, scan, true_depth
from runtime.base.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.streams.memory import ScanLines, ScanMemory


def drive(memory, count, *, first=0, late_ns=0, speed_m=1.0, calibration=CALIBRATION, poses=pose):
    """Recall frames, each `speed_m` after the one before; return the last answer."""
    for number in range(first, first + count):
        ahead_m = number * speed_m
        stamp_ns = number * PERIOD_NS + late_ns
        found = memory.recall(scan(ahead_m), poses(ahead_m), stamp_ns, calibration)
    return found


def slowly_allowed(present, row, column, depth):
    """`ScanLines.bounds` for one pixel, written out."""
    height, width = present.shape
    first = max(0, 4 * (column // 4) - 4)
    strips = [slice(max(0, 4 * cell - 4), 4 * cell + 8) for cell in range(-(-width // 4))]

    def on_line(at, strip):
        return (present[max(0, at - 1) : at + 2, strip] > 0).any()

    gaps = []
    for strip in strips:
        lines = [at for at in range(height) if on_line(at, strip)]
        for upper, lower in pairwise(lines):
            gaps += [lower - upper] * (lower - upper - 1)
    most = 4 * (np.median(gaps) if gaps else 1)
    strip = slice(first, 4 * (column // 4) + 8)
    sides, used = [], [row] if on_line(row, strip) else []
    for step in (-1, 1):
        at = row
        while 0 <= at < height and on_line(at, strip):  # out of the pixel's own line
            at += step
        while 0 <= at < height and not on_line(at, strip):
            at += step
        sides.append(0 <= at < height and abs(at - row) <= most)
        used += [at] if sides[-1] else []
    if not (on_line(row, strip) or all(sides)):
        return False
    near = [present[max(0, at - 1) : at + 2, strip] for at in used]
    returns = np.concatenate([each[each > 0] for each in near])
    return returns.min() < depth * 1.03 and depth < returns.max() * 1.03


@pytest.mark.parametrize("kind", ["lines", "scattered", "one line", "none", "dense"])
def test_the_gate_is_that_of_the_slow_reference(kind):
    rng = np.random.default_rng(1)
    shares = {"lines": 0.6, "scattered": 0.03, "one line": 0.6, "none": 0.0, "dense": 0.9}
    present = rng.uniform(4, 8, (61, 50)) * (rng.random((61, 50)) < shares[kind])
    rows = np.arange(61)[:, None]
    if kind == "lines":
        present *= (rows % 9 == 0) & ((rows < 25) | (rows > 50))
    elif kind == "one line":
        present *= rows == 30
    present = present.astype(np.float32)
    pixel = rng.integers(0, present.size, 200)
    depth = rng.uniform(3, 9, 200).astype(np.float32)
    allowed = np.logical_and(*ScanLines.of(present).bounds(pixel, depth))
    expected = [
        slowly_allowed(present, *divmod(p, 50), d) for p, d in zip(pixel, depth, strict=True)
    ]
    np.testing.assert_array_equal(allowed, expected)
    assert allowed.any() == (kind != "none")


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (4.5e5, 5.4e6, 100.0)])
def test_earlier_returns_lie_where_the_scene_is_now(origin):
    found = drive(ScanMemory(), 5, poses=lambda ahead_m: pose(ahead_m, origin))
    row, column = np.nonzero(found.returns)
    assert found.returned == len(row) > 500
    assert not (scan(4.0)[row, column] > 0).any()
    depth = found.returns[row, column]
    assert (depth < true_depth(4.0, row - 0.6) * 1.01).all()
    assert (depth > true_depth(4.0, row + 0.6) / 1.01).all()
    assert found.rejected_share is not None
    assert found.rejected_share < 0.2


def test_returns_land_where_the_lens_shows_them():
    lens = Calibration(
        CALIBRATION.intrinsics, np.eye(4), SIZE, lens="plumb_bob", distortion=[-0.2, 0.02, 0, 0]
    )
    world = np.stack(
        np.meshgrid(np.arange(-8, 8, 0.05), [1.2, 1.6, 2.0, 2.4], [12.0]), axis=-1
    ).reshape(-1, 3)
    first, second = (lens.project((world - [0, 0, z]).astype(np.float32), SIZE) for z in (0.0, 1.0))
    memory = ScanMemory()
    memory.recall(first, pose(0.0), 0, lens)
    found = memory.recall(second, pose(1.0), PERIOD_NS, lens).returns
    assert np.count_nonzero(found) > 20
    every_row = np.argwhere(found > 0)
    near = [(second[max(0, r - 2) : r + 3, max(0, c - 8) : c + 9] > 0).any() for r, c in every_row]
    assert np.mean(near) > 0.95


def test_a_car_that_drove_on_leaves_no_trail_and_nothing_is_added_in_the_sky():
    memory = ScanMemory()
    with_car = scan(0.0)
    with_car[25:66:10, 80:120:2] = 9.0
    memory.recall(with_car, pose(0.0), 0, CALIBRATION)
    found = memory.recall(scan(1.0), pose(1.0), PERIOD_NS, CALIBRATION).returns
    assert np.count_nonzero(found) > 100
    assert not ((found > 7.5) & (found < 8.5))[:57, 70:130].any()
    only_road = scan(1.0, lines=range(65, 118, 10))
    memory = ScanMemory()
    drive(memory, 1)
    found = memory.recall(only_road, pose(1.0), PERIOD_NS, CALIBRATION).returns
    assert found[64:].any()
    assert not found[:64].any()


def test_what_is_hidden_now_does_not_shine_through():
    memory = ScanMemory()
    drive(memory, 1)
    hidden = scan(1.0)
    hidden[25:66:10, 60:140:2] = 5.0  # a lorry
    found = memory.recall(hidden, pose(1.0), PERIOD_NS, CALIBRATION).returns
    assert not found[25:66, 68:132].any()


def test_no_return_is_added_at_an_edge_of_the_depth():
    memory = ScanMemory()
    for number, side in enumerate((30, 40)):
        depth = scan(number)
        depth[25:66:10, 100 - side : 100 + side : 2] = 4.0 - number  # a post comes nearer
        found = memory.recall(depth, pose(number), number * PERIOD_NS, CALIBRATION).returns
    assert (found[25:66, 64:136] > 0).any()
    row, column = np.nonzero(found)
    window = np.ones((5, 5), np.uint8)
    least = cv2.erode(np.where(depth > 0, depth, 99), window)[row, column]
    greatest = cv2.dilate(depth, window)[row, column]
    assert (least >= 0.9 * found[row, column]).all()
    assert (found[row, column] >= 0.5 * greatest).all()


@pytest.mark.parametrize("count", [19, 20])  # the last frame is remembered, or too near to others
def test_nothing_is_added_where_traffic_was_or_comes(count):
    class Answer:
        class_names, semantic = ("road", "car"), np.zeros(SIZE, np.uint8)

    Answer.semantic[:, 90:110] = 1
    found = []
    for answered in (False, True):
        memory = ScanMemory()
        drive(memory, count, speed_m=0.2)
        if answered:
            memory.answered(Answer())
        found.append(drive(memory, 1, first=count, speed_m=0.2).returns)
    assert found[0][:, 90:110].any()
    assert not found[1][:, 88:112].any()
    np.testing.assert_array_equal(found[1][:, :60], found[0][:, :60])
    without, nearer = (np.count_nonzero(each[80:, 80:86]) for each in found)
    assert nearer < 0.75 * without, "it may have come nearer"
    later = drive(memory, 1, first=count + 1, speed_m=0.2).returns
    assert later[:, 90:110].any()


def test_a_standing_car_adds_nothing_and_keeps_nothing():
    memory = ScanMemory()
    assert drive(memory, 4).returned > 0
    for number in range(4, 30):
        found = memory.recall(scan(3.0), pose(3.0), number * PERIOD_NS, CALIBRATION)
    assert found.returned == 0
    assert drive(ScanMemory(), 20, speed_m=0.01).returned == 0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"late_ns": -30 * PERIOD_NS}, "stamps do not rise"),
        ({"late_ns": 30 * PERIOD_NS}, "a gap longer than the memory"),
        ({"poses": lambda ahead_m: pose(ahead_m + 9)}, "the poses jump"),
        ({"poses": lambda ahead_m: pose(ahead_m, yaw_deg=90)}, "the poses jump"),
        (
            {"calibration": Calibration(CALIBRATION.intrinsics + 0.0, pose(0.1), SIZE)},
            "another calibration or size",
        ),
    ],
)
def test_what_does_not_continue_empties_the_memory(change, reason):
    memory = ScanMemory()
    drive(memory, 5)
    assert drive(memory, 1, **{"first": 5, **change}).returned == 0
    assert memory.cleared == {reason: 1}
    assert drive(memory, 1, **{"first": 6, **change}).returned > 0


def test_no_measurement_is_neither_remembered_nor_a_bound():
    marked, clean = ScanMemory(), ScanMemory()
    for number in range(4):
        depth = scan(number)
        spoilt = np.where(depth > 0, depth, np.float32(np.nan))
        spoilt[0], spoilt[1], spoilt[2] = np.inf, -1, np.finfo(np.float32).max
        at = pose(float(number)), number * PERIOD_NS, CALIBRATION
        found, expected = marked.recall(spoilt, *at), clean.recall(depth, *at)
    np.testing.assert_array_equal(found.returns, expected.returns)


def test_bad_input_is_an_error_and_changes_nothing():
    memory = ScanMemory()
    drive(memory, 4)
    for depth, matrix in (
        (scan(4.0).astype(np.float64), pose(4.0)),
        (scan(4.0), np.full((4, 4), np.nan)),
        (scan(4.0)[:-1], pose(4.0)),
    ):
        with pytest.raises(InputError):
            memory.recall(depth, matrix, 4 * PERIOD_NS, CALIBRATION)
    assert drive(memory, 1, first=4).returned == drive(ScanMemory(), 5).returned
    with pytest.raises(InputError, match="seconds must be"):
        ScanMemory(0)


def test_memory_is_bounded():
    memory, dense = ScanMemory(10), np.full((480, 640), 20, np.float32)
    calibration = Calibration(CALIBRATION.intrinsics, np.eye(4))
    for number in range(15):
        memory.recall(dense, pose(float(number)), number * PERIOD_NS, calibration)
    assert sum(each.points.nbytes for each in memory._scans) <= 10 * 10_000 * 12


def test_one_wrong_pose_does_not_switch_the_memory_off():
    """The first poses of an odometry are often wrong."""
    memory = ScanMemory()
    drive(memory, 2, poses=lambda ahead_m: pose(1.5 * ahead_m))  # the first comparison
    for number in range(2, 8):
        found = drive(memory, 1, first=number, poses=lambda ahead_m: pose(0.5 + ahead_m))
        assert found.off == ""
    assert found.returned > 0


def test_wrong_poses_switch_the_memory_off_until_they_are_right_again():
    memory = ScanMemory()
    off = drive(memory, 12, poses=lambda ahead_m: pose(1.5 * ahead_m))
    assert off.returned == 0
    assert "% off the present ones" in off.off
    found = drive(memory, 20, first=12, poses=lambda ahead_m: pose(6.0 + ahead_m))
    assert found.off == off.off  # not tried again yet
    found = drive(memory, 50, first=32, poses=lambda ahead_m: pose(6.0 + ahead_m), speed_m=0.35)
    assert found.off == ""
    assert found.returned > 0
