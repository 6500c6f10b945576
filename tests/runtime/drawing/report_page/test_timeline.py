"""However many frames there are, the timeline stays small and loses none of them."""

import itertools
import random

import pytest

from runtime.drawing.report_page.timeline import Moment, Timeline


def filled(n):
    rng = random.Random(0)
    moments = [
        Moment(
            str(index),
            response_ms=None if rng.random() < 0.1 else rng.uniform(1, 100),
            marks=("late", "late") if rng.random() < 0.05 else (),
            returns=None if rng.random() < 0.1 else rng.randrange(1000),
        )
        for index in range(n)
    ]
    timeline = Timeline()
    for moment in moments:
        timeline.add(moment)
    return timeline, moments


@pytest.mark.parametrize("n", [1, 2, 2048, 2049, 10_000])
@pytest.mark.parametrize("at_most", [1, 7, 2048])
def test_spans_hold_all_frames_in_order(n, at_most):
    timeline, moments = filled(n)
    spans = timeline.spans(at_most)
    assert 1 <= len(spans) <= at_most
    assert timeline.frames == n
    assert [spans[0].first, spans[-1].last] == [0, n - 1]
    for before, span in itertools.pairwise(spans):
        assert span.first == before.last + 1
    answered = [moment.response_ms for moment in moments if moment.response_ms is not None]
    assert sum(span.answered for span in spans) == len(answered)
    assert sum(span.sum_ms for span in spans) == pytest.approx(sum(answered))
    assert max(span.high_ms for span in spans) == max(answered, default=0)
    late = sum(bool(moment.marks) for moment in moments)
    assert sum(span.marks["late"] for span in spans) == timeline.marks["late"] == late
    assert timeline.flagged == late
    assert sum(span.returns for span in spans) == sum(moment.returns or 0 for moment in moments)


def test_a_span_names_what_is_in_it():
    timeline, moments = filled(10_000)
    for span in timeline.spans(100):
        inside = moments[span.first : span.last + 1]
        times = [moment.response_ms for moment in inside if moment.response_ms is not None]
        assert (span.low_ms, span.high_ms) == (min(times), max(times))
        assert span.mean_ms == pytest.approx(sum(times) / len(times))
        returns = [moment.returns for moment in inside if moment.returns is not None]
        assert span.mean_returns == pytest.approx(sum(returns) / len(returns))
        assert span.name == ""


def test_few_frames_keep_their_names():
    timeline, _ = filled(3)
    assert [span.name for span in timeline.spans()] == ["0", "1", "2"]


def test_nothing_has_no_spans():
    assert Timeline().spans(10) == []
