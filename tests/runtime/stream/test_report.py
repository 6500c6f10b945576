"""Figures of a run that are not those of a frame."""

import pytest

from runtime.stream.pipeline import INVALID, OK, SKIPPED, FrameRecord, StreamResult
from runtime.stream.report import frames_per_second


def result_of(*statuses):
    records = tuple(FrameRecord(i, str(i), status) for i, status in enumerate(statuses))
    return StreamResult(records, wall_s=0.5, interrupted=False)


@pytest.mark.parametrize(
    ("statuses", "rate"),
    [
        ((OK, OK, OK), 6.0),
        ((OK, SKIPPED, OK, SKIPPED), 4.0),
        ((OK, INVALID), 4.0),  # was predicted, though not usable
        ((SKIPPED, SKIPPED), None),
        ((), None),
    ],
)
def test_skipped_frames_are_no_frames_a_second(statuses, rate):
    assert frames_per_second(result_of(*statuses)) == rate
