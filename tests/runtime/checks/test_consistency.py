import numpy as np
import pytest

from runtime.base.errors import InputError
from runtime.checks.consistency import ConsistencyCheck
from runtime.engine.prediction import Latency, Prediction


def answer(depth=None, boundary=None):
    heads = {"depth": depth, "boundary": boundary}
    given = {head: values for head, values in heads.items() if values is not None}
    return Prediction(given, (60, 80), (60, 80), latency=Latency(0, 0, 0, 0))


def scan():
    """Every other pixel of every other line; left of column 40 at 10 m, right of it at 20 m."""
    depth = np.zeros((60, 80), np.float32)
    depth[::2, :40:2], depth[::2, 40::2] = 10, 20
    return depth


def test_a_share_of_the_returns_is_held_out_and_others_each_time():
    check = ConsistencyCheck(0.05)
    depth = scan()
    depth[1, :3] = np.nan, np.inf, -1
    before = depth.copy()
    left, held_out = check.hold_out(depth)
    np.testing.assert_array_equal(depth, before)
    assert 30 <= held_out.sum() <= 90, "5 % of 1200"
    assert (left[held_out] == 0).all()
    np.testing.assert_array_equal(left[~held_out], depth[~held_out])
    assert not held_out[1].any(), "what is no return cannot be held out"
    assert (check.hold_out(depth)[1] != held_out).any()


def test_returns_are_held_out_in_squares_of_an_eighth_of_the_height():
    _, held_out = ConsistencyCheck(0.3).hold_out(np.ones((80, 95), np.float32))
    whole = held_out[::10, ::10].repeat(10, axis=0).repeat(10, axis=1)[:, :95]
    np.testing.assert_array_equal(held_out, whole)
    assert 0.2 < held_out.mean() < 0.4


def test_the_figures_by_hand_and_their_running_means():
    check = ConsistencyCheck(0.5)
    depth = scan()
    held_out = np.zeros_like(depth, dtype=bool)
    held_out[0, [0, 40]] = True
    predicted = np.full_like(depth, 20)  # twice what was held out on the left, right on the right
    boundary = np.full_like(depth, 0.1)
    boundary[:, 38:41] = 0.7
    camera_only = answer(depth=np.full_like(depth, 40))
    found = check.score(answer(predicted, boundary), camera_only, depth, held_out)
    assert found.holdout_error == pytest.approx(np.log(2) / 2)
    assert found.scale_error == pytest.approx((np.log(4) + np.log(2)) / 2)
    # 30 jumps; the others are 0.7 where a boundary pixel is beside what lies between the returns.
    assert 0.7 - 0.2 < found.edge_agreement < 0.7 - 0.1

    again = check.score(answer(depth.copy(), 0 * boundary), None, depth, held_out)
    assert again.holdout_error == pytest.approx(0.9 * found.holdout_error)
    assert again.edge_agreement == pytest.approx(0.9 * found.edge_agreement)
    assert again.scale_error == found.scale_error, "not due this time"


def test_the_change_is_against_the_first_minute_of_the_stream():
    """Healthy figures differ between rigs, so a stream is compared with its own first minute."""
    check = ConsistencyCheck(0.5)
    depth, held_out = scan(), np.zeros((60, 80), dtype=bool)
    held_out[0, 0] = True
    start_ns = 1_700_000_000_000_000_000

    def score(second, factor):
        answers = (answer(depth * np.float32(scale)) for scale in factor)
        return check.score(*answers, depth, held_out, stamp_ns=start_ns + round(second * 1e9))

    for second, error in ((0, 1.1), (30, 1.3), (59.9, 1.2)):
        found = score(second, (error, 1.5))
        assert (found.holdout_change, found.scale_change) == (None, None)
    usual = np.log([1.1, 1.3, 1.2]).mean()
    for second in range(60, 160):
        found = score(second, (2.0, 0.5))
    assert found.holdout_change == pytest.approx(found.holdout_error - usual, abs=1e-6)
    assert found.holdout_change == pytest.approx(np.log(2) - usual, abs=1e-3)
    assert found.scale_change == pytest.approx(np.log(0.5 / 1.5), abs=1e-3)
    assert found.edge_change is None, "the model has no boundary"


def test_the_edges_agree_less_when_the_returns_are_shifted():
    boundary = np.zeros((60, 80), np.float32)
    boundary[:, 39:41] = 1
    nothing = np.zeros((60, 80), dtype=bool)
    upright, shifted, turned = (ConsistencyCheck(0.05) for _ in range(3))
    fits = upright.score(answer(boundary=boundary), None, scan(), nothing).edge_agreement
    moved = np.roll(scan(), 12, axis=1)
    off = shifted.score(answer(boundary=boundary), None, moved, nothing).edge_agreement
    assert fits > 0.9
    assert off < 0.1
    lines = np.ascontiguousarray(scan().T[:60])  # a horizontal edge counts as well
    across = np.zeros((60, 60), np.float32)
    across[39:41] = 1
    found = turned.score(answer(boundary=across), None, lines, nothing[:, :60]).edge_agreement
    assert found > 0.9


def test_the_scale_is_due_every_tenth_frame():
    check = ConsistencyCheck(0.05)
    due = []
    for _ in range(21):
        due.append(check.scale_is_due)
        check.score(answer(), None, scan(), np.zeros((60, 80), dtype=bool))
    assert [number for number, is_due in enumerate(due) if is_due] == [0, 10, 20]


@pytest.mark.parametrize("share", [0, -0.1, 0.6, float("nan"), True, "5 %"])
def test_an_invalid_share(share):
    with pytest.raises(InputError, match="share of the returns"):
        ConsistencyCheck(share)
