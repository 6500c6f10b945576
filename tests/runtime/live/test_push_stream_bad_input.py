"""Messages and options that streams and replays refuse, and how they count them."""

import threading
from collections import Counter

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from runtime.errors import InputError
from runtime.io.calibration import Calibration
from runtime.live.push_stream import PushStream
from runtime.live.replay import replay
from runtime.live.stream_counter import StreamCounter
from stream_messages import add_up, depth, image


def test_invalid_messages_are_refused_and_counted(setup):
    stream = setup().stream
    with pytest.raises(InputError, match="rgb must be uint8"):
        stream.push_image(image().astype(np.float32), 0)
    with pytest.raises(InputError, match="sparse_depth must be float32"):
        stream.push_depth(depth().astype(np.float64), 0)
    with pytest.raises(InputError, match="sparse_depth must have the shape"):
        stream.push_depth(np.zeros((3, 4, 5), np.float32), 0)
    with pytest.raises(InputError, match="stamp must be"):
        stream.push_image(image(), None)
    counts = add_up(stream.counts)
    assert counts.images.errors == {"bad_message": 1, "bad_stamp": 1}
    assert counts.depths.errors == {"bad_message": 2}


OF_BOTH = [
    {"max_skew_ms": -1}, {"max_skew_ms": float("nan")}, {"reuse_depth_ms": "x"}, {"calibration": 5},
    {"consistency": "x"}, {"scan_stamp": "first"}, {"pose_frame": "lidar"},
    {"pose_frame": "wheel"}, {"pose_frame": 3},
]  # fmt: skip
OF_A_STREAM = [
    {"deadline_ms": 0}, {"deadline_ms": "1"}, {"deadline_ms": True}, {"max_wait_ms": float("inf")},
    {"watchdog": 5}, {"on_result": 5}, {"on_error": "print"}, {"on_state": 0},
    {"sensor_clock": 1.5},
]  # fmt: skip


@pytest.mark.parametrize("options", OF_BOTH + OF_A_STREAM, ids=str)
def test_options_out_of_range(setup, checked_predictor, options):
    with pytest.raises(InputError, match=next(iter(options))):
        setup(**options)
    if options in OF_BOTH:
        with pytest.raises(InputError, match=next(iter(options))):
            replay(checked_predictor(), [], **options)


# --- any sequence, with threads ----------------------------------------------------------------


def arrays(*good):
    """Arrays of any shape and type, other objects, and valid arrays."""
    shapes = st.one_of(
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=40),
        st.sampled_from([(32, 40), (32, 40, 3), (1, 1, 3), (0, 3), (5, 3), (5, 4), (5, 2), (8, 8)]),
    )
    types = st.one_of(
        st.sampled_from([np.uint8, np.uint16, np.int16, np.float16, np.float32, np.float64]),
        st.sampled_from([bool, object, complex, "U3", "M8[ns]", [("x", "f4")], ">f4"]),
    )
    return st.one_of(
        st.builds(np.zeros, shapes, types),
        st.builds(np.ma.zeros, shapes, types),
        st.sampled_from([None, "picture", b"1", 3.0, [], [[[1, 2, 3]]], np.float32(1), *good]),
    )


def flawed_depth(value):
    return np.full((32, 40), value, np.float32)


images = arrays(image(1), image(2), np.zeros((32, 40, 3), np.uint8), image(3)[:, ::-1])
depths = arrays(depth(1), depth(2), depth().T, *map(flawed_depth, (np.nan, -np.inf, -1, 1e30, 0)))
scans = arrays(*(np.full((9, 4), value, np.float32) for value in (1, np.nan, np.inf, 1e30, -1)))
stamps = st.one_of(
    st.sampled_from([None, "now", True, 2**70, 1j, np.zeros(2), np.float32(0.5), np.uint64(7)]),
    st.floats(),
    st.integers(-(2**64), 2**64),
    st.floats(0, 3),
    st.floats(0, 3),
)
messages_of_all_sensors = st.lists(
    st.one_of(
        st.tuples(st.just("push_image"), images, stamps),
        st.tuples(st.just("push_depth"), depths, stamps),
        st.tuples(st.just("push_points"), scans, stamps),
    ),
    min_size=100,
    max_size=150,
)


def is_stamp(stamp):
    """Whether it fits in 64 bits of nanoseconds, computed independently of the code."""
    if isinstance(stamp, float | np.floating):
        return bool(abs(stamp) * 1e9 < 2**63)
    return type(stamp) in (int, np.uint64) and -(2**63) <= stamp < 2**63


def is_message(method, data):
    if type(data) is not np.ndarray:
        return False
    if method == "push_image":
        return data.dtype == "=u1" and data.shape[2:] == (3,) and min(data.shape[:2]) >= 32
    return data.dtype == "=f4" and data.ndim == 2 and (method == "push_depth" or data.shape[1] > 2)


def test_bad_messages_are_refused_or_flagged_and_accounted_for(checked_predictor):
    bad = Counter()

    @settings(
        # Always the same messages; shrinking lists of so many takes minutes.
        max_examples=10,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
    )
    @given(messages=messages_of_all_sensors)
    def push_them(messages):
        push_to_one(messages, threads=1)
        push_to_one(messages, threads=3)
        replay_them(messages)

    def push_to_one(messages, threads):
        wrong, answers = [], []
        stream = PushStream(
            checked_predictor(),
            max_wait_ms=0,
            calibration=Calibration(np.eye(3), np.eye(4)),
            on_result=answers.append,
        )

        def push(part):
            for method, data, stamp in part:
                expected = None
                if not is_message(method, data):
                    expected = "must"
                if not is_stamp(stamp):
                    expected = "stamp must"
                try:
                    getattr(stream, method)(data, stamp)
                    message = None
                except InputError as error:
                    message = str(error)
                if (message is None) != (expected is None) or (message and expected not in message):
                    wrong.append((method, data, stamp, message))

        pushers = [
            threading.Thread(target=push, args=(messages[k::threads],)) for k in range(threads)
        ]
        for pusher in pushers:
            pusher.start()
        for pusher in pushers:
            pusher.join(60)
            assert not pusher.is_alive()
        stream.close()
        assert wrong == []
        check(messages, add_up(stream.counts), answers)

    def replay_them(messages):
        errors, counter = [], StreamCounter()
        recording = [(method.removeprefix("push_"), *others) for method, *others in messages]
        calibration = Calibration(np.eye(3), np.eye(4))
        answers = list(
            replay(
                checked_predictor(),
                recording,
                calibration=calibration,
                on_error=errors.append,
                counter=counter,
            )
        )
        outcomes = add_up(counter.counts())
        check(messages, outcomes, answers)
        unfit = outcomes.images.errors.get("input_error", 0)
        refused = outcomes.errors.get("bad_stamp", 0) + outcomes.errors.get("bad_message", 0)
        assert len(errors) == refused + unfit

    def check(messages, counts, answers):
        assert counts.pushed == len(messages)
        assert counts.pending == 0
        assert counts.images.answered == len(answers)
        no_stamp = sum(not is_stamp(stamp) for _, _, stamp in messages)
        refused = sum(
            not (is_stamp(stamp) and is_message(method, data)) for method, data, stamp in messages
        )
        assert counts.errors.get("bad_stamp", 0) == no_stamp
        assert counts.errors.get("bad_message", 0) == refused - no_stamp
        bad["refused"] += refused
        for result in answers:
            prediction = result.prediction
            assert np.isfinite(prediction.depth).all()
            if not result.rgb.any():
                assert "image_black" in result.health
                bad["black"] += 1
            if not prediction.depth_returns:
                assert "no_depth" in prediction.degraded

    push_them()
    assert bad["refused"] >= 2000
    assert bad["black"] > 0, "some of the bad ones come through and are flagged"
