"""Figures of a run that are not those of a frame."""

import csv
from pathlib import Path

import pytest

from runtime.run.pipeline import INVALID, OK, SKIPPED, FrameRecord, StreamResult
from runtime.run.report_files import frames_csv
from runtime.run.run_report import RunReport
from runtime.sync.latency import MissedDeadlines


@pytest.fixture
def report_of(model_file):
    """Make the report of these records."""
    from runtime import Predictor
    from runtime.io.engine_facts import engine_facts

    with Predictor(model_file(), warmup=0) as predictor:
        engine = engine_facts(predictor)

    def make(*records, wall_s=0.5, interrupted=False, deadline_ms=None):
        stream = StreamResult(records, wall_s, interrupted)
        return RunReport(engine, {}, Path("out"), (), stream, deadline_ms)

    return make


def records_of(*statuses):
    return [FrameRecord(i, str(i), status) for i, status in enumerate(statuses)]


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
def test_skipped_frames_are_no_frames_a_second(report_of, statuses, rate):
    assert report_of(*records_of(*statuses)).frames_per_second == rate


def test_the_skew_is_that_of_both_sensors_stamps_where_there_are_any(report_of):
    stamps_ns = [(1_000, 8_001_000), (100_001_000, 97_001_000), (200_000_000, None)]
    records = [
        FrameRecord(i, str(i), OK, image_stamp_ns=image, depth_stamp_ns=depth)
        for i, (image, depth) in enumerate(stamps_ns)
    ]
    report = report_of(*records)
    skew = report.stages["skew"]
    assert (skew.n, skew.mean_ms, skew.max_ms) == (2, 5.5, 8)
    rows = csv.DictReader(frames_csv(report).splitlines())
    assert [row["skew_ms"] for row in rows] == ["8.000", "3.000", ""]
    assert "skew" not in report_of(records[2]).stages


def test_the_exit_code_is_that_of_the_deadline_first(report_of):
    late, skipped = FrameRecord(0, "0", OK, age_ms=30.0), FrameRecord(1, "1", SKIPPED)
    in_time = FrameRecord(2, "2", OK, age_ms=20.0)
    assert report_of(in_time, deadline_ms=25.0).exit_code == 0
    assert report_of(in_time, skipped, deadline_ms=25.0).exit_code == 3
    assert report_of(late, skipped, deadline_ms=25.0).exit_code == 4
    assert report_of(late, in_time).exit_code == 0
    assert report_of(in_time, interrupted=True).exit_code == 3


def test_health_and_degraded_are_counted_by_frame(report_of):
    records = [
        FrameRecord(0, "0", OK, degraded=("no_depth",), health=("image_frozen",)),
        FrameRecord(1, "1", OK, health=("image_frozen", "image_black")),
    ]
    frames = report_of(*records).document()["frames"]
    assert frames["degraded"] == {"no_depth": 1}
    assert frames["health"] == {"image_frozen": 2, "image_black": 1}


def test_a_frame_exactly_on_the_deadline_is_in_time_and_one_without_answer_ends_no_run(report_of):
    ages_ms = [11, 10, 12, None, 13]
    records = [FrameRecord(i, str(i), OK, age_ms=age_ms) for i, age_ms in enumerate(ages_ms)]
    report = report_of(*records, deadline_ms=10)
    assert report.missed == MissedDeadlines(count=3, longest_run=2)
    rows = csv.DictReader(frames_csv(report).splitlines())
    assert [row["missed_deadline"] for row in rows] == ["1", "0", "1", "", "1"]
    assert report_of(*records).missed is None
