from runtime.live.message_counter import MessageCounter, MessageCounts
from runtime.sync.matching import Decided, Discarded, Message, Pair
from runtime.sync.outcome import Outcome, Sensor

IMAGE, SCAN = Message(1.0, 10**9), Message(0.9, 9 * 10**8)
BOTH, ALONE, REUSED = Pair(IMAGE, SCAN), Pair(IMAGE, None), Pair(IMAGE, SCAN, reused=True)


def test_each_message_is_counted_once_with_its_outcome():
    counter = MessageCounter()
    for sensor in (*Sensor, *Sensor, *Sensor, Sensor.IMAGE, Sensor.IMAGE):
        counter.push(sensor)
    counter.record_pair(BOTH, Outcome.ANSWERED)
    counter.record_pair(BOTH, Outcome.OVERTAKEN)
    counter.record_pair(ALONE, Outcome.ANSWERED)
    counter.record_pair(REUSED, Outcome.ANSWERED)
    gone = [Discarded(Sensor.DEPTH, SCAN, Outcome.NO_IMAGE)]
    counter.record_decided(Decided(discarded=gone, out_of_order=True, jumped_back=True))
    counter.record_decided(Decided(out_of_order=True))
    counts = counter.counts()
    assert counts.images == MessageCounts(pushed=5, answered=3, dropped={"overtaken": 1})
    assert counts.depths == MessageCounts(
        pushed=3, answered=1, dropped={"overtaken": 1}, unmatched={"no_image": 1}
    )
    assert (counts.pushed, counts.answered, counts.pending) == (8, 4, 1)
    assert (counts.dropped, counts.unmatched) == ({"overtaken": 2}, {"no_image": 1})
    assert (counts.camera_only, counts.reused) == (1, 1)
    assert (counts.out_of_order, counts.jumps_back) == (2, 1)
    assert {type(reason) for reason in counts.dropped} == {str}, "printed without the enum's name"


def test_an_answer_that_was_not_fetched_counts_as_dropped():
    counter = MessageCounter()
    for pair in (BOTH, ALONE, REUSED):
        counter.record_pair(pair, Outcome.ANSWERED)
        counter.record_unread(pair)
    counts = counter.counts()
    assert (counts.answered, counts.camera_only, counts.reused) == (0, 0, 0)
    assert (counts.images.dropped, counts.depths.dropped) == ({"unread": 3}, {"unread": 1})


def test_every_outcome_is_of_one_kind():
    for outcome in Outcome:
        counter = MessageCounter()
        counter.push(Sensor.DEPTH)
        counter.record(Sensor.DEPTH, outcome)
        assert counter.counts().pending == 0, outcome
