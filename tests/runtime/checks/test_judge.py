"""The rule that chooses a reading, and what is judged at all."""

from dataclasses import replace

import numpy as np
import pytest

from painted_street import SIZE, judged, paint, scan_of, street, street_map
from runtime import Predictor
from runtime.checks.finding import Severity
from runtime.checks.judge import FIRST_FRAMES, NO_EVIDENCE, NO_RETURNS, NOWHERE, Judge, choose
from runtime.checks.readings import READINGS
from runtime.checks.view import Answer
from runtime.recordings.bundled_stream import bundled_frames
from runtime.streams.frame import Frame
from runtime.streams.frame_view import view_of
from runtime.streams.messages import Depth

FLOORS = {"first": 0.1, "second": 0.1}


def names(views):
    return [each.name for each in judged(views).findings]


@pytest.mark.parametrize(("first", "second", "chosen"), [
    ([0.5] * 5, [-0.2] * 5, ["first"]),
    ([0.05] * 5, [-0.2] * 5, []),  # too little
    ([1.2, -0.5, 0.9, -0.6, 0.4], [0.0] * 5, []),  # by chance
    ([0.5] * 5, [0.49] * 5, ["first", "second"]),  # equal effect
    ([0.11] * 5, [0.095] * 5, ["first"]),  # not told apart, and no clear gain
    ([0.3] * 5, [0.5] * 5, ["second"]),
    ([0.4], [0.1], ["first"]),
], ids=["clear", "too little", "by chance", "equal", "unclear", "better", "one frame"])  # fmt: skip
def test_a_reading_must_be_clearly_better(first, second, chosen):
    gains = {("first", ""): np.array(first), ("second", ""): np.array(second)}
    choice = choose(gains, FLOORS)
    assert [name for name, _ in choice.readings] == chosen if chosen else choice is None
    if choice is not None:
        assert choice.unclear == (("second",) if second == [0.095] * 5 else ())


def test_members_are_chosen_on_other_frames_than_they_are_judged_by():
    """Each member gains in one frame alone: none of them is a reading of the recording."""
    gains = {("first", str(each)): np.eye(5)[each] - 0.1 for each in range(5)}
    assert choose(gains, FLOORS) is None
    gains["first", "all"] = np.full(5, 0.3)
    assert choose(gains, FLOORS).readings == (("first", "all"),)


def weakened(view, share):
    """The view of a model that sees boundaries only so strongly."""
    answer = Answer(view.answer.boundary * np.float32(share), view.answer.log_depth)
    return replace(view, answer=answer)


def test_nothing_is_judged_by_answers_without_evidence():
    """The returns are in another unit, and are not judged in the dark."""
    wrong = [street_map(seed, lambda depth: depth * np.float32(10)) for seed in range(5)]
    found = judged(wrong)
    assert [each.name for each in found.findings] == ["unit"]
    assert "range_instead_of_depth_along_axis" in found.tested, "as bad as given is told apart"
    assert "not told apart" not in found.text
    judgement = judged([weakened(view, 0.2) for view in wrong])
    (finding,) = judgement.findings
    assert finding.name == NO_EVIDENCE
    assert finding.severity is Severity.NOTE
    assert finding.reason == ""
    assert judgement.not_tested == tuple(each.name for each in READINGS)
    assert "can be tested" in judgement.text

    def unrelated(view):
        boundary = view.answer.boundary[:, ::-1] * 0
        boundary[::7] = 1  # strong, and nothing to do with the depth
        return replace(view, answer=Answer(boundary, view.answer.log_depth))

    assert names([unrelated(view) for view in wrong]) == [NO_EVIDENCE]
    dark = [replace(view, answer=replace(view.answer, doubts=("image_dark",))) for view in wrong]
    (finding,) = judged(dark).findings
    assert (finding.name, finding.evidence["image_dark"]) == (NO_EVIDENCE, 1)
    assert names([*dark[:2], *wrong[2:]]) == ["unit"], "most frames count"
    depth_alone = [weakened(view, 0) for view in wrong]  # a model without boundaries
    assert names(depth_alone) == ["unit"]


def test_returns_that_fit_nowhere():
    def shuffled(depth):
        return np.random.default_rng(0).permutation(depth.ravel()).reshape(SIZE)

    (finding,) = judged([street_map(seed, shuffled) for seed in range(3)]).findings
    assert finding.name == NOWHERE
    assert finding.severity is Severity.FAULT
    assert "neither as given nor in" in finding.says
    assert names([street(seed, points=scan_of(paint(seed + 20))) for seed in range(3)]) == [NOWHERE]


def test_no_return_in_the_image_and_few_of_them():
    behind = [street(seed, points=-scan_of(paint(seed)) * 0.01) for seed in range(3)]
    assert names(behind) in ([NO_RETURNS], ["turned_lidar"])
    few = [street(seed, points=scan_of(paint(seed))[:150]) for seed in range(3)]
    assert judged(few).frames == 0


def test_the_last_frames_count():
    judging = Judge()
    right, wrong = street_map(0), street_map(0, lambda depth: depth * np.float32(10))
    for view in (right, right, wrong):
        judging.add(view)
    assert judging.judgement().findings == ()
    for view in (wrong, wrong):
        judging.add(view)
    assert judging.judgement().findings[0].name == "unit"
    for _ in range(FIRST_FRAMES):  # an early alarm is cleared
        judging.add(right)
    assert judging.judgement().findings == ()


@pytest.mark.parametrize(("ratio", "depth_scale", "focal_px", "advised"), [
    (3.9, 256, None, ["depth_scale=1000"]), (0.1, 256, None, ["depth_scale=` of about 26"]),
    (1e3, None, None, ["check their unit"]), (4, None, 300, ["unit", "300 px", "about 1200"]),
    (4, 256, 180.5, ["depth_scale=1000", "180.5 px", "about 720"]),
])  # fmt: skip
def test_the_advice_on_a_unit_names_what_was_given(ratio, depth_scale, focal_px, advised):
    view = street_map(0, lambda depth: depth * np.float32(ratio))
    views = [replace(view, depth_scale=depth_scale, focal_px=focal_px)] * 3
    (finding,) = judged(views).findings
    assert finding.name == "unit"
    assert all(each in finding.text for each in advised)
    assert ("px" in finding.text) == (focal_px is not None)


def test_a_bundled_model_on_frames_of_the_bundled_stream():
    with Predictor("ssdnet-nano", threads=1, warmup=0) as predictor:
        frames = bundled_frames()[:3]
        answers = [predictor.predict(each.rgb, None) for each in frames]

    def found(change):
        maps = (Depth(np.ascontiguousarray(change(each.sparse_depth))) for each in frames)
        made = [Frame(each.image, depth) for each, depth in zip(frames, maps, strict=True)]
        views = [view_of(frame, answer) for frame, answer in zip(made, answers, strict=True)]
        return names(views)

    assert found(lambda depth: depth) == []
    for factor in np.float32([0.1, 1000 / 256, 10]):
        assert found(lambda depth, by=factor: depth * by) == ["unit"]
    assert found(lambda depth: depth[:, ::-1]) == ["mirrored"]
    inverse = found(lambda depth: np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0))
    assert inverse == ["inverse_depth"]
