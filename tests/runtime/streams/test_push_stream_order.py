"""Which image of a live stream is answered with which depth, and who waits for it."""

from runtime.geometry.rig import Rig
from stream_messages import add_up, image, push_pair


def test_a_live_push_never_waits_and_the_newest_complete_frame_wins(setup):
    made = setup()
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
    made = setup(max_wait_ms=50, rig=Rig(reuse_depth_ms=0))
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
