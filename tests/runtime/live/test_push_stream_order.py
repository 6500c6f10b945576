"""Which image is answered with which depth and in what order, and who waits for it."""

import threading
from collections import Counter

import pytest

from stream_messages import add_up, depth, image, push_all, push_depth, push_image, push_pair


def test_a_replay_answers_every_frame_in_order_from_two_threads(setup):
    stream = setup(mode="replay").stream
    n = 60

    def push_all(push, make):
        for number in range(n):
            push(make(number), number / 10)

    sensors = [
        threading.Thread(target=push_all, args=(stream.push_image, image)),
        threading.Thread(target=push_all, args=(stream.push_depth, depth)),
    ]

    def close_after_both():
        for sensor in sensors:
            sensor.join()
        stream.close()

    threads = [*sensors, threading.Thread(target=close_after_both)]
    for thread in threads:
        thread.start()
    results = list(stream)
    for thread in threads:
        thread.join()
    assert [result.image_stamp for result in results] == [number / 10 for number in range(n)]
    assert [result.depth_stamp for result in results] == [number / 10 for number in range(n)]
    assert [result.sequence for result in results] == list(range(n))
    for number, result in enumerate(results):
        assert (result.prediction.depth == depth(number) + 1).all()
    counts = add_up(stream.counts)
    assert counts.pushed == counts.answered == 2 * n


def test_a_replay_makes_the_pusher_wait_until_there_is_room(setup):
    made = setup(mode="replay")
    made.predictor.gate.clear()
    pusher, done = push_all(made, 20)
    made.predictor.entered.acquire()
    assert made.clock.holds_up(
        pusher,
        made.stream._changed,
        still=lambda: len(made.stream._ready) == 2,
        ended=done.is_set,
    )
    assert made.stream.counts.images.pushed == 4, "one predicted, two ready, one held up"
    made.predictor.gate.set()
    assert [next(made.stream).image_stamp for _ in range(20)] == [n / 10 for n in range(20)]
    pusher.join(60)


@pytest.mark.parametrize("mode", ["live", "replay"])
def test_a_reader_is_woken_once_for_each_result(setup, mode):
    made = setup(mode=mode)
    waits = Counter()
    wait = made.clock.wait

    def count(changed, timeout_ns):
        waits[threading.current_thread().name] += 1
        wait(changed, timeout_ns)

    made.clock.wait = count
    reader = threading.Thread(target=lambda: next(made.stream), name="reader")
    reader.start()
    assert made.clock.holds_up(reader, made.stream._answered)
    push_pair(made.stream, 0)
    reader.join(60)
    assert waits["reader"] == 1


def test_a_live_push_never_waits_and_the_newest_complete_frame_wins(setup):
    made = setup(mode="live")
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    for number in range(1, 100):
        push_pair(made.stream, number)
    made.predictor.gate.set()
    made.stream.close()
    counts = add_up(made.stream.counts)
    assert counts.images.answered + counts.images.dropped["unread"] == 2
    assert counts.images.dropped["overtaken"] == 98
    assert counts.dropped["overtaken"] == 2 * 98
    (result,) = list(made.stream)
    assert result.image_stamp == 9.9, "the newest answer, of the newest frame"


def test_a_complete_frame_is_not_overtaken_by_one_without_depth(setup):
    made = setup(mode="live", max_wait_ms=50, reuse_depth_ms=0)
    made.predictor.gate.clear()
    push_pair(made.stream, 0)
    made.predictor.entered.acquire()
    push_pair(made.stream, 1)
    made.stream.push_image(image(2), 0.2)
    made.clock.advance_ms(50)
    made.stream.push_image(image(3), 0.3)  # decides that 0.2 stays alone
    made.predictor.gate.set()
    made.predictor.entered.acquire()
    dropped = add_up(made.stream.counts).images.dropped
    assert dropped["incomplete"] == 1
    assert "overtaken" not in dropped
    made.stream.close()
    assert next(made.stream).image_stamp == 0.3


def test_an_image_without_depth_is_answered_from_the_camera_alone(setup):
    made = setup(mode="live", max_wait_ms=50)
    made.stream.push_image(image(), 5)
    made.clock.advance_ms(49)
    assert made.stream.counts.pending == 1
    made.clock.advance_ms(1)
    result = next(made.stream)
    assert (result.image_stamp, result.depth_stamp, result.skew_ms) == (5, None, None)
    assert result.prediction.degraded == ("no_depth",)
    assert result.latency_ms == 50
    counts = add_up(made.stream.counts)
    assert (counts.images.answered, counts.camera_only) == (1, 1)


def test_depth_without_an_image_is_dropped_and_counted(setup):
    made = setup(mode="live", max_wait_ms=50)
    made.stream.push_depth(depth(), 5)
    made.stream.push_depth(depth(), 6)
    made.stream.close()
    assert list(made.stream) == []
    counts = add_up(made.stream.counts)
    assert counts.depths.unmatched == {"no_image": 2}
    assert counts.pending == 0


def test_a_replay_waits_for_the_other_sensor_however_long_max_wait_is(setup):
    """Pairs follow from the stamps, not from the threads' turns."""
    made = setup(mode="replay", max_wait_ms=5)
    camera, pushed = push_all(made, 40, push_image)
    assert made.clock.holds_up(camera, made.stream._changed, ended=pushed.is_set)
    for _ in range(199):
        made.clock.advance_ms(10)
        assert made.stream.counts.images.pushed == 17
    lidar, _ = push_all(made, 40, push_depth)
    closer = threading.Thread(target=lambda: (camera.join(), lidar.join(), made.stream.close()))
    closer.start()
    assert [(r.image_stamp, r.depth_stamp) for r in made.stream] == [
        (number / 10, number / 10) for number in range(40)
    ]
    closer.join(60)


@pytest.mark.parametrize("max_wait_ms", [0, 50])
def test_a_replay_of_one_sensor_alone_pauses_once_and_goes_on(setup, max_wait_ms):
    made = setup(mode="replay", max_wait_ms=max_wait_ms)
    camera, pushed = push_all(made, 40, push_image)
    assert made.clock.holds_up(camera, made.stream._changed, ended=pushed.is_set)
    assert made.stream.counts.images.pushed == 17
    made.clock.advance_ms(2000)
    results = [next(made.stream) for _ in range(24)]
    camera.join(60)
    made.stream.close()
    results += made.stream
    assert [result.image_stamp for result in results] == [number / 10 for number in range(40)]
    assert add_up(made.stream.counts).camera_only == 40


def test_a_replay_of_depth_alone_is_unmatched_to_the_last(setup):
    made = setup(mode="replay", max_wait_ms=0)
    lidar, pushed = push_all(made, 17, push_depth)
    made.clock.holds_up(lidar, made.stream._changed, ended=pushed.is_set)
    made.clock.advance_ms(2000)
    lidar.join(60)
    made.stream.close()
    assert add_up(made.stream.counts).unmatched == {"no_image": 17}
