"""Messages and options that streams and replays refuse, and how they count them."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from runtime.base.errors import InputError
from runtime.geometry.calibration import Calibration
from runtime.geometry.rig import Rig
from runtime.streams.push_stream import PushStream
from runtime.streams.replay import replay
from runtime.streams.stream_counter import StreamCounter
from stream_messages import add_up, depth, image


def test_images_and_depth_maps_of_another_size_than_the_calibrations_are_refused(setup):
    """Their answers would have a wrong focal length; points are projected into the image's size."""
    stream = setup(rig=Rig(calibration=Calibration(np.eye(3), np.eye(4), (48, 64)))).stream
    with pytest.raises(InputError, match=r"for images of \(48, 64\)"):
        stream.push_image(image(), 0)
    with pytest.raises(InputError, match=r"for images of \(48, 64\)"):
        stream.push_depth(depth(), 0)
    assert add_up(stream.counts).errors == {"bad_message": 2}


OF_BOTH = [
    {"consistency": "x"}, {"rig": 5}, {"rig": Calibration(np.eye(3), np.eye(4))},
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


def test_poses_need_a_calibration(setup, checked_predictor):
    rig = Rig(pose_frame="lidar")
    with pytest.raises(InputError, match=r"Rig\(calibration="):
        setup(rig=rig)
    with pytest.raises(InputError, match=r"Rig\(calibration="):
        replay(checked_predictor(), [], rig)


# --- any sequence, with threads ----------------------------------------------------------------

IMAGES = [image(1), image(2), np.zeros((32, 40, 3), np.uint8), image(3)[:, ::-1]]
DEPTHS = [depth(1), depth().T, *(0 * depth() + value for value in (np.nan, -np.inf, -1, 1e30, 0))]
SCANS = [np.full((9, 4), value, np.float32) for value in (1, np.nan, np.inf, 1e30, -1)]
NO_ARRAYS = [
    None, "picture", b"1", [[[1, 2, 3]]], np.float32(1), np.zeros(0, object),
    *(np.zeros(shape, dtype) for shape in ((), (5, 2), (32, 40, 4), (1, 1, 3), (2, 3, 4, 5))
      for dtype in (np.uint8, np.float16, np.float64, ">f4", "M8[ns]", [("x", "f4")])),
    np.ma.zeros((32, 40, 3), np.uint8), np.ma.zeros((32, 40), np.float32),
]  # fmt: skip
STAMPS = [0.0, 0.5, 1.5, 10**9, 2 * 10**9, -3, np.float32(0.5), np.uint64(7)]
NO_STAMPS = [None, "now", True, 2**70, 1j, np.zeros(2), float("nan"), 1e300]


def any_messages(random, count):
    """Messages of all sensors, of which a third each have no valid array and no valid stamp."""
    good = {"image": IMAGES, "depth": DEPTHS, "points": SCANS}
    for _ in range(count):
        kind = str(random.choice([*good]))
        arrays = NO_ARRAYS if random.random() < 1 / 3 else good[kind]
        stamps = NO_STAMPS if random.random() < 1 / 3 else STAMPS
        place = random.integers(len(arrays)), random.integers(len(stamps))
        yield kind, arrays[place[0]], stamps[place[1]], arrays is good[kind], stamps is STAMPS


# Stamps are wrong on purpose: they may be those of two clocks.
@pytest.mark.filterwarnings("ignore::runtime.geometry.assumptions.AssumptionWarning")
@pytest.mark.parametrize("way", ["one thread", "three threads", "replay"])
@pytest.mark.parametrize("seed", range(3))
def test_bad_messages_are_refused_or_flagged_and_accounted_for(checked_predictor, way, seed):
    messages = list(any_messages(np.random.default_rng(seed), 300))
    rig, refused, answers = Rig(calibration=Calibration(np.eye(3), np.eye(4))), [], []
    if way == "replay":
        counter = StreamCounter()
        recording = [message[:3] for message in messages]
        options = {"rig": rig, "on_error": refused.append, "counter": counter}
        answers += replay(checked_predictor(), recording, **options)
        counts = add_up(counter.counts)
    else:
        options = {"rig": rig, "on_result": answers.append}
        stream = PushStream(checked_predictor(), max_wait_ms=0, **options)

        def push(part):
            for kind, data, stamp, *_ in part:
                try:
                    getattr(stream, f"push_{kind}")(data, stamp)
                except InputError as error:
                    refused.append(error)

        step = {"one thread": 1, "three threads": 3}[way]
        with ThreadPoolExecutor(step) as pool:
            list(pool.map(push, (messages[start::step] for start in range(step))))
        stream.close()
        counts = add_up(stream.counts)
    assert (counts.pushed, counts.pending) == (300, 0)
    assert counts.images.answered == len(answers) > 0
    assert counts.errors["bad_stamp"] == sum(not is_stamp for *_, is_stamp in messages)
    assert counts.errors["bad_message"] == sum(
        is_stamp and not is_array for *_, is_array, is_stamp in messages
    )
    assert all("must" in str(error) for error in refused)
    for result in answers:
        assert np.isfinite(result.prediction.depth).all()
        assert result.rgb.any() or "image_black" in result.health
        assert result.prediction.depth_returns or "no_depth" in result.prediction.degraded


@pytest.mark.parametrize("predictor", [None, "ssdnet-lite", object()])
def test_what_is_no_predictor_is_refused_at_once(predictor):
    with pytest.raises(InputError, match="predictor must be a Predictor"):
        PushStream(predictor)
