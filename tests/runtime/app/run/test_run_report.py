"""Figures of a run that are not those of a frame."""

import csv
import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest

import runtime
from outcomes import outcome
from runtime import Predictor
from runtime.app.run.engine_facts import engine_facts
from runtime.app.run.frame_record import INVALID, OK, SKIPPED
from runtime.app.run.options import RunOptions, UsageError
from runtime.app.run.outages import Outage
from runtime.app.run.pipeline import StreamResult
from runtime.app.run.run_report import RunReport, describe_run, frames_csv
from runtime.checks.finding import Finding, Severity
from runtime.checks.judge import Judgement
from runtime.command.machine import MachineFacts
from runtime.contract.degraded import IMPLAUSIBLE_POSES
from runtime.streams.statistics import MissedDeadlines


@pytest.fixture
def report_of(model_file):
    """Make the report of these records."""
    with Predictor(model_file(), warmup=0) as predictor:
        engine = engine_facts(predictor)

    def make(*records, wall_s=0.5, interrupted=False, **options):
        stream = StreamResult(records, wall_s, interrupted)
        options = RunOptions(demo=True, **options)
        return RunReport(engine, options, {}, (), stream)

    return make


def records_of(*statuses):
    return [outcome(number, status) for number, status in enumerate(statuses)]


@pytest.mark.parametrize(("statuses", "rate"), [
    ((OK, OK, OK), 6.0),
    ((OK, INVALID), 4.0),  # was predicted, though not usable
    ((SKIPPED,), None),
])  # fmt: skip
def test_skipped_frames_are_no_frames_a_second(report_of, statuses, rate):
    assert report_of(*records_of(*statuses)).frames_per_second == rate


def test_the_skew_is_that_of_both_sensors_stamps_where_there_are_any(report_of):
    stamps_ns = [(1_000, 8_001_000), (100_001_000, 97_001_000), (200_000_000, None)]
    records = [
        outcome(number, image_stamp=image, depth_stamp=depth)
        for number, (image, depth) in enumerate(stamps_ns)
    ]
    report = report_of(*records)
    skew = report.statistics.stages["skew"]
    assert (skew.n, skew.mean_ms, skew.max_ms) == (2, 5.5, 8)
    rows = csv.DictReader(frames_csv(report).splitlines())
    assert [row["skew_ms"] for row in rows] == ["8.000", "3.000", ""]
    assert "skew" not in report_of(records[2]).statistics.stages


def test_the_exit_code_is_that_of_the_deadline_first(report_of):
    late, in_time = outcome(0, deadline_met=False), outcome(1, deadline_met=True)
    skipped = outcome(2, SKIPPED)
    assert report_of(in_time, deadline_ms=25.0).exit_code == 0
    assert report_of(in_time, skipped, deadline_ms=25.0).exit_code == 3
    assert report_of(late, skipped, deadline_ms=25.0).exit_code == 4
    assert report_of(outcome(0)).exit_code == 0
    assert report_of(outcome(0, INVALID)).exit_code == 3
    assert report_of(in_time, interrupted=True).exit_code == 3


@pytest.mark.parametrize(("times_ms", "fault"), [
    ([10.0] * 99 + [500.0], None),
    ([10.0] * 98 + [30.0] * 2, "take up to 30.00 ms, expected 25 ms"),
    ([10.0] * 99, "is not known from 99 answers: 100 are needed"),
])  # fmt: skip
def test_a_deadline_of_99_percent(report_of, times_ms, fault):
    records = [outcome(number, latency_ms=ms) for number, ms in enumerate(times_ms)]
    report = report_of(*records, deadline_p99_ms=25.0)
    assert report.exit_code == (0 if fault is None else 4)
    assert fault is None or fault in report.p99_fault
    assert report_of(*records).p99_fault is None


def test_fail_on_names_what_ends_a_run_with_an_error(report_of):
    frozen = outcome(0, health=("image_frozen",), degraded=("no_depth",))

    def code(*reasons, records=(frozen,), outages=(), deadline_ms=None):
        report = report_of(*records, deadline_ms=deadline_ms, fail_on=list(reasons))
        report = dataclasses.replace(report, outages=outages)
        return report.exit_code, report.document()["failed_on"]

    assert code() == (0, {})
    assert code("image_black", "skipped,late") == (0, {})
    assert code("image_black, no_depth", "image_frozen") == (5, {"no_depth": 1, "image_frozen": 1})
    assert code("invalid", records=[outcome(0, INVALID)]) == (5, {"invalid": 1})
    assert code("camera_silent", outages=(Outage("camera_silent", 1.0, 2.0),))[0] == 5
    assert code("lidar_silent", outages=(Outage("camera_silent", 1.0, 2.0),))[0] == 0
    late = outcome(0, deadline_met=False)
    assert code("late", records=[late], deadline_ms=5) == (5, {"late": 1}), "5 comes before 4"
    with pytest.raises(UsageError, match=r"--fail-on takes some of skipped, .*got 'dark'"):
        code("no_depth,dark")


def test_a_frame_without_answer_ends_no_run_of_late_ones(report_of):
    met = [False, True, False, None, False]
    records = [
        outcome(number, SKIPPED if each is None else OK, deadline_met=each)
        for number, each in enumerate(met)
    ]
    report = report_of(*records, deadline_ms=10)
    assert report.statistics.missed == MissedDeadlines(count=3, longest_run=2)
    rows = csv.DictReader(frames_csv(report).splitlines())
    assert [row["missed_deadline"] for row in rows] == ["1", "0", "1", "", "1"]
    assert report_of(outcome(0)).statistics.missed is None


def test_what_pngs_cannot_hold_is_said(report_of):
    report = replace(report_of(*records_of(OK)), beyond_png={"depth": 1234, "uncertainty": 0})
    text = describe_run(report)
    assert "warning: 1,234 pixels of depth are beyond 256.00 m, saved as 65535" in text
    assert "uncertainty are beyond" not in text


def test_the_report_of_a_rig_adds_up_those_of_its_cameras(report_of):
    """The cameras run one after the other, so their times add up, too."""
    first, second = (
        replace(report_of(*records_of(OK, OK), wall_s=wall_s), beyond_png={"depth": 1234})
        for wall_s in (0.5, 1.5)
    )
    mirrored = Finding("w_first", "mirrored", Severity.FAULT, {}, IMPLAUSIBLE_POSES)
    judgement = Judgement(tested=("turned",), frames=3)
    outages = (Outage("camera_silent", 1.0, 2.0),)
    second = replace(second, findings=(mirrored,), judgements={"": judgement}, outages=outages)
    rig = RunReport.of_rig({"a": first, "b": second}, first.options, interrupted=False)
    both = rig.document()
    assert both["frames"]["implausible_poses"] == "b: mirrored"  # only the second camera showed it
    assert "warning: b: mirrored" in describe_run(rig)
    assert both["frames"]["findings"][0]["says"] == "b: mirrored"
    assert both["frames"]["readings"]["b"]["tested"] == ("turned",)
    assert both["outages"][0]["text"] == "b: camera silent 1.0 to 2.0 s"
    assert both["depth_png"]["beyond"] == {"depth": 2468}
    assert (both["wall_s"], both["frames_per_second"]) == (2.0, 2.0)


def test_the_facts_are_those_of_the_predictor(model_file, contract):
    with Predictor(model_file(), size=40, threads=1, warmup=1) as predictor:
        facts = engine_facts(predictor)
        assert facts["ssdnet"] == runtime.__version__
        model, provider = facts["model"], facts["provider"]
        assert (model["name"], model["sha256"]) == (contract.model_name, predictor.model.sha256)
        assert (model["size_asked"], model["heads"]) == (40, predictor.heads)
        assert (provider["asked"], provider["threads"]) == ("cpu", 1)
        assert facts["first_inference_ms"] > 0
    machine = {**facts["machine"], "cpu": "Fast One", "instruction_sets": ("AVX2", "VNNI")}
    assert MachineFacts(**machine).processor == "Fast One (AVX2, VNNI)"
    assert facts["libraries"]["numpy"] == np.__version__
    names = {"ssdnet", "model", "provider", "machine", "libraries", "load_ms", "first_inference_ms"}
    assert json.loads(json.dumps(facts)).keys() == names
