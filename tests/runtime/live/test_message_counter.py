from runtime.live.message_counter import MessageCounter, MessageCounts
from runtime.sync.outcome import Outcome, Sensor


def test_each_message_is_counted_once_with_its_outcome():
    counter = MessageCounter()
    for sensor in (*Sensor, *Sensor, *Sensor, Sensor.IMAGE):
        counter.push(sensor)
    counter.record_frame(Outcome.ANSWERED, with_depth=True)
    counter.record_frame(Outcome.OVERTAKEN, with_depth=True)
    counter.record_frame(Outcome.ANSWERED, with_depth=False)
    counter.record(Sensor.DEPTH, Outcome.NO_IMAGE)
    counts = counter.counts(out_of_order=2, jumps_back=1)
    assert counts.images == MessageCounts(pushed=4, answered=2, dropped={"overtaken": 1})
    assert counts.depths == MessageCounts(
        pushed=3, answered=1, dropped={"overtaken": 1}, unmatched={"no_image": 1}
    )
    assert (counts.pushed, counts.answered, counts.pending) == (7, 3, 1)
    assert (counts.dropped, counts.unmatched) == ({"overtaken": 2}, {"no_image": 1})
    assert (counts.camera_only, counts.out_of_order, counts.jumps_back) == (1, 2, 1)
    assert {type(reason) for reason in counts.dropped} == {str}, "printed without the enum's name"


def test_an_answer_that_was_not_fetched_counts_as_dropped():
    counter = MessageCounter()
    for with_depth in (True, False):
        counter.record_frame(Outcome.ANSWERED, with_depth=with_depth)
        counter.record_unread(with_depth=with_depth)
    counts = counter.counts(out_of_order=0, jumps_back=0)
    assert (counts.answered, counts.camera_only) == (0, 0)
    assert (counts.images.dropped, counts.depths.dropped) == ({"unread": 2}, {"unread": 1})


def test_every_outcome_is_of_one_kind():
    for outcome in Outcome:
        counter = MessageCounter()
        counter.push(Sensor.DEPTH)
        counter.record(Sensor.DEPTH, outcome)
        assert counter.counts(out_of_order=0, jumps_back=0).pending == 0, outcome
