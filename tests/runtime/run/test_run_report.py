"""Figures of a run that are not those of a frame."""

import csv

import pytest

from runtime.run.pipeline import INVALID, OK, SKIPPED, FrameRecord, StreamResult
from runtime.run.run_report import frames_csv, frames_per_second, missed, stage_statistics
from runtime.sync.latency import MissedDeadlines


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


def test_the_skew_is_that_of_both_sensors_stamps_where_there_are_any():
    stamps_ns = [(1_000, 8_001_000), (100_001_000, 97_001_000), (200_000_000, None)]
    records = tuple(
        FrameRecord(i, str(i), OK, image_stamp_ns=image, depth_stamp_ns=depth)
        for i, (image, depth) in enumerate(stamps_ns)
    )
    skew = stage_statistics(StreamResult(records, wall_s=1, interrupted=False))["skew"]
    assert (skew.n, skew.mean_ms, skew.max_ms) == (2, 5.5, 8)
    rows = csv.DictReader(frames_csv(records, deadline_ms=None).splitlines())
    assert [row["skew_ms"] for row in rows] == ["8.000", "3.000", ""]
    assert "skew" not in stage_statistics(result_of(OK, OK))


def test_a_frame_exactly_on_the_deadline_is_in_time_and_one_without_answer_ends_no_run():
    ages_ms = [11, 10, 12, None, 13]
    records = [FrameRecord(i, str(i), OK, age_ms=age_ms) for i, age_ms in enumerate(ages_ms)]
    assert missed(records, 10) == MissedDeadlines(count=3, longest_run=2)
    rows = csv.DictReader(frames_csv(records, deadline_ms=10).splitlines())
    assert [row["missed_deadline"] for row in rows] == ["1", "0", "1", "", "1"]
    assert missed(records, None) is None
