"""However many frames there are, the timeline stays small and loses none of them."""

import itertools
import random

import pytest

from outcomes import outcome
from runtime.drawing.report_page.timeline import Timeline
from runtime.sync.frame_outcome import SKIPPED


def filled(n):
    rng = random.Random(0)

    def any_outcome(number):
        if rng.random() < 0.1:
            return outcome(number, SKIPPED)
        return outcome(
            number,
            latency_ms=rng.uniform(1, 100),
            degraded=("no_depth", "no_depth") if rng.random() < 0.05 else (),
            returns=rng.randrange(1000),
        )

    outcomes = [any_outcome(number) for number in range(n)]
    timeline = Timeline()
    for each in outcomes:
        timeline.add(each)
    return timeline, outcomes


@pytest.mark.parametrize("n", [1, 2, 2048, 2049, 10_000])
@pytest.mark.parametrize("at_most", [1, 7, 2048])
def test_spans_hold_all_frames_in_order(n, at_most):
    timeline, outcomes = filled(n)
    spans = timeline.spans(at_most)
    assert 1 <= len(spans) <= at_most
    assert timeline.frames == n
    assert [spans[0].first, spans[-1].last] == [0, n - 1]
    for before, span in itertools.pairwise(spans):
        assert span.first == before.last + 1
    answered = [each for each in outcomes if each.prediction is not None]
    times = [each.latency_ms for each in answered]
    assert sum(span.answered for span in spans) == len(answered)
    assert sum(span.sum_ms for span in spans) == pytest.approx(sum(times))
    assert max(span.high_ms for span in spans) == max(times, default=0)
    flagged = sum(bool(each.prediction.degraded) for each in answered)
    assert sum(span.marks["no_depth"] for span in spans) == timeline.marks["no_depth"] == flagged
    assert timeline.flagged == flagged + n - len(answered)
    returns = sum(each.prediction.depth_returns for each in answered)
    assert sum(span.returns for span in spans) == returns


def test_a_span_names_what_is_in_it():
    timeline, outcomes = filled(10_000)
    for span in timeline.spans(100):
        inside = [each for each in outcomes[span.first : span.last + 1] if each.prediction]
        times = [each.latency_ms for each in inside]
        assert (span.low_ms, span.high_ms) == (min(times), max(times))
        assert span.mean_ms == pytest.approx(sum(times) / len(times))
        returns = [each.prediction.depth_returns for each in inside]
        assert span.mean_returns == pytest.approx(sum(returns) / len(returns))
        assert span.name == ""


def test_few_frames_keep_their_names():
    timeline, _ = filled(3)
    assert [span.name for span in timeline.spans()] == ["0", "1", "2"]


def test_nothing_has_no_spans():
    assert Timeline().spans(10) == []
