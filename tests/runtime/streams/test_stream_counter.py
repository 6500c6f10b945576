import json

from runtime.streams.matching import Discarded, Pair
from runtime.streams.messages import Depth, Image, Outcome, Sensor
from runtime.streams.statistics import MissedDeadlines
from runtime.streams.stream_counter import MessageCounts, StreamCounter
from stream_messages import result

IMAGE, SCAN = Image(None, stamp_ns=10**9), Depth(None, stamp_ns=9 * 10**8)
BOTH, ALONE, REUSED = Pair(IMAGE, SCAN), Pair(IMAGE), Pair(IMAGE, SCAN, reused=True)


def test_each_message_is_counted_once_with_its_outcome():
    counter = StreamCounter()
    for sensor in (*Sensor, *Sensor, *Sensor, Sensor.IMAGE, Sensor.IMAGE):
        counter.push(sensor)
    for pair in (BOTH, ALONE, REUSED):
        counter.record_answer(pair, result())
    counter.record_pair(BOTH, Outcome.OVERTAKEN)
    gone = [Discarded(SCAN, Outcome.NO_IMAGE)]
    counter.record_discarded(gone, jumped_back=True)
    counts = counter.counts
    assert counts.images == MessageCounts(pushed=5, answered=3, dropped={"overtaken": 1})
    assert counts.depths == MessageCounts(
        pushed=3, answered=1, dropped={"overtaken": 1}, unmatched={"no_image": 1}
    )
    assert (counts.pushed, counts.answered, counts.pending) == (8, 4, 1)
    assert (counts.dropped, counts.unmatched) == ({"overtaken": 2}, {"no_image": 1})
    assert (counts.camera_only, counts.reused) == (1, 1)
    assert counts.jumps_back == 1
    assert {type(reason) for reason in counts.dropped} == {str}, "printed without the enum's name"


def test_an_answer_that_was_not_fetched_counts_as_dropped():
    counter = StreamCounter()
    for pair in (BOTH, ALONE, REUSED):
        counter.record_answer(pair, result())
        counter.record_unread(pair)
    counts = counter.counts
    assert (counts.answered, counts.camera_only, counts.reused) == (0, 0, 0)
    assert (counts.images.dropped, counts.depths.dropped) == ({"unread": 3}, {"unread": 1})


def test_every_outcome_is_of_one_kind():
    for outcome in Outcome:
        counter = StreamCounter()
        counter.push(Sensor.DEPTH, outcome)
        assert counter.counts.pending == 0, outcome


def test_misses_and_their_longest_run():
    counter = StreamCounter(50.0)
    for number, met in enumerate([True, False, False, True, False]):
        counter.record_answer(BOTH, result(number, deadline_met=met))
    statistics = counter.statistics
    assert statistics.missed == MissedDeadlines(count=3, longest_run=2)
    assert (statistics.stages["latency"].n, statistics.stages["jitter"]) == (5, None)
    deadline = {"deadline_ms": 50.0, "count": 3, "longest_run": 2}
    assert json.loads(json.dumps(statistics.to_dict()))["deadline"] == deadline
    *lines, last = statistics.table().splitlines()
    assert last == "missed deadlines of 50 ms: 3, longest run 2"
    stages = [line.split()[0] for line in lines]
    assert stages[5:10] == ["latency", "age", "jitter", "skew", "depth_age"]
