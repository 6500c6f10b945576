"""The outcome of a run: one typed object, from which every table and document is made."""

import csv
import io
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from runtime.app.run.frame_record import CALIBRATION, LATE, OK, STAGES, FrameRecord
from runtime.app.run.options import OVERLAY, RunOptions
from runtime.app.run.outages import Outage, Timeline
from runtime.app.run.pipeline import StreamResult
from runtime.checks.finding import Finding, Severity
from runtime.checks.judge import Judgement
from runtime.command.wording import with_flags
from runtime.contract.degraded import IMPLAUSIBLE_DEPTH, IMPLAUSIBLE_POSES
from runtime.drawing.encode import METRES_PNG_MAX_M, METRES_PNG_SCALE
from runtime.engine.prediction import Cleaned, Prediction
from runtime.files.atomic_write import atomic_write
from runtime.streams.statistics import MissCounter, StreamStatistics, latency_statistics

REPORT_FORMAT, REPORT_VERSION = "ssdnet-run", "2.0"
# The report comes first: it is removed first, as a folder with a report counts as complete.
RUN_FILES = REPORT_FILE, FRAMES_FILE = Path("report.json"), Path("frames.csv")
FRAMES_SKIPPED, DEADLINE_MISSED, REASON_FOUND = 3, 4, 5  # exit codes
_QUEUED = 2  # periods by which the age of an answer grows if a machine cannot keep up


@dataclass(frozen=True)
class RunReport:
    """The outcome of a run.

    Attributes:
        engine: the facts that `engine_facts` returned.
        options: options of the run.
        inputs: what was read: the options of the source, and what it found; ready for JSON.
        saved: kinds of files that were written for each frame.
        stream: results of the frames.
        findings: what was found about calibration, depth and poses, and was not accepted.
        judgements: which readings of the recording were tested, by camera; the only camera of a
            run has the name "".
        outages: when a sensor was out.
        timeline: times of the frames; None if they are unknown, or belong to several cameras.
        beyond_png: for each kind of file, the number of pixels that its PNGs cannot hold.
    """

    engine: Mapping[str, Any]
    options: RunOptions
    inputs: Mapping[str, Any]
    saved: tuple[str, ...]
    stream: StreamResult
    findings: tuple[Finding, ...] = ()
    judgements: Mapping[str, Judgement] = field(default_factory=dict)
    outages: tuple[Outage, ...] = ()
    timeline: Timeline | None = None
    beyond_png: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of_rig(
        cls, reports: Mapping[str, "RunReport"], options: RunOptions, *, interrupted: bool
    ) -> "RunReport":
        """Combine the reports of several cameras; frames are named CAMERA/FRAME in the result.

        Args:
            reports: the report of each camera; engine and kinds of files are taken from the first.
            options: options of all cameras.
            interrupted: whether cameras are missing.
        """
        first, *_ = reports.values()
        records, findings, outages = list[FrameRecord](), list[Finding](), list[Outage]()
        judgements, beyond_png = dict[str, Judgement](), Counter[str]()
        for camera, report in reports.items():
            records += (replace(each, name=f"{camera}/{each.name}") for each in report.records)
            findings += (replace(each, says=f"{camera}: {each.says}") for each in report.findings)
            outages += (replace(each, camera=camera) for each in report.outages)
            for judgement in report.judgements.values():
                judgements[camera] = judgement
            beyond_png.update(report.beyond_png)
        streams = [report.stream for report in reports.values()]
        is_interrupted = interrupted or any(each.interrupted for each in streams)
        return replace(
            first,
            options=options,
            inputs={"cameras": {camera: report.inputs for camera, report in reports.items()}},
            stream=StreamResult(
                tuple(records), sum(each.wall_s for each in streams), is_interrupted
            ),
            findings=tuple(findings),
            judgements=judgements,
            outages=tuple(outages),
            timeline=None,
            beyond_png=beyond_png,
        )

    @property
    def out(self) -> Path:
        """Folder of the results."""
        return self.options.folder

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """Results of the frames, in order."""
        return self.stream.records

    @property
    def predictions(self) -> list[Prediction]:
        """Predictions of the frames that have one, in order, without arrays."""
        return [each.prediction for each in self.records if each.prediction is not None]

    @property
    def scenario(self) -> str:
        """The scenario of MLPerf to which the run belongs."""
        return "single-stream" if self.options.rate is None else "constant-stream"

    @property
    def by_status(self) -> Counter[str]:
        """Number of frames with each status."""
        return Counter(record.status for record in self.records)

    @property
    def degraded(self) -> Counter[str]:
        """Number of frames with each reason of `Prediction.degraded`."""
        return Counter(reason for record in self.records for reason in record.degraded)

    @property
    def health(self) -> Counter[str]:
        """Number of frames with each fault of a sensor."""
        return Counter(reason for record in self.records for reason in record.health)

    @property
    def depth_sources(self) -> Counter[str]:
        """Number of frames with depth, by its origin (own or reused) and how returns were moved."""
        return Counter(
            f"{record.depth_source}, motion {record.result.depth_motion}"
            for record in self.records
            if record.result and record.depth_source
        )

    @property
    def memory(self) -> str:
        """What earlier returns added, in words; "" if nothing was added and nothing is wrong."""
        results = [record.result for record in self.records if record.result]
        fed = [each.memory_returns for each in results if each.memory_returns]
        mean = sum(fed) / max(1, len(fed))
        off = Counter(each.memory_off for each in results if each.memory_off)
        emptied = self.inputs.get("memory_emptied", {})
        parts = [f"{mean:,.0f} earlier returns a frame in {len(fed)} frames"] if fed else []
        parts += [f"off in {count} frames, because {reason}" for reason, count in off.items()]
        parts += [f"emptied {count} times: {reason}" for reason, count in emptied.items()]
        return "; ".join(parts)

    @property
    def by_network_size(self) -> Counter[str]:
        """Number of frames for each size at which the network ran."""
        return Counter(size_text(each.network_size) for each in self.predictions)

    @property
    def reasons(self) -> Counter[str]:
        """Number of frames, or of outages, with each of `REASONS`."""
        counts = self.degraded + self.health + self.by_status
        counts[LATE] = sum(record.deadline_met is False for record in self.records)
        for reason, text in self.implausible.items():
            counts[reason] = max(counts[reason], int(text is not None))
        counts[CALIBRATION] = len(self._warnings)
        silent = Counter(each.reason for each in self.outages if each.scans is None)
        del counts[OK]
        return +(counts + silent)

    @property
    def implausible(self) -> dict[str, str | None]:
        """Why depth and poses cannot be right, by their reason; None: nothing was found."""
        faults = [each for each in self.findings if each.severity is Severity.FAULT]
        poses = [each.text for each in faults if each.reason == IMPLAUSIBLE_POSES]
        depth = [each.text for each in faults if each.reason != IMPLAUSIBLE_POSES]
        texts = {IMPLAUSIBLE_DEPTH: depth, IMPLAUSIBLE_POSES: poses}
        return {reason: "; ".join(each) or None for reason, each in texts.items()}

    @property
    def _warnings(self) -> list[Finding]:
        return [each for each in self.findings if each.severity is Severity.WARNING]

    @property
    def failed_on(self) -> dict[str, int]:
        """The reasons of --fail-on that were found, with their counts."""
        counts = self.reasons
        return {each: counts[each] for each in self.options.failing if each in counts}

    @property
    def not_ok(self) -> list[FrameRecord]:
        """The frames without a usable answer."""
        return [record for record in self.records if record.status != OK]

    def times_ms(self, figure: str) -> list[float]:
        """The values of a figure, of the frames that have it."""
        return [each.times_ms[figure] for each in self.records if figure in each.times_ms]

    @cached_property
    def statistics(self) -> StreamStatistics:
        """Statistics over the frames that passed each stage, without stages that none passed."""
        times_ms = {stage: self.times_ms(stage) for stage in STAGES}
        stages = {stage: latency_statistics(each) for stage, each in times_ms.items() if each}
        misses = MissCounter()
        for record in self.records:
            if record.deadline_met is not None:
                misses.record(not record.deadline_met)
        deadline_ms = self.options.deadline_ms
        missed = None if deadline_ms is None else misses.misses()
        return StreamStatistics(stages, deadline_ms, missed)

    @cached_property
    def p99_fault(self) -> str | None:
        """How --deadline-p99-ms was missed; None: it was met, or not given."""
        if (limit_ms := self.options.deadline_p99_ms) is None:
            return None
        latency = latency_statistics(times_ms := self.times_ms("latency"))
        if latency is None or latency.p99_ms is None:
            return f"the 99th percentile is not known from {len(times_ms)} answers: 100 are needed"
        if latency.p99_ms <= limit_ms:
            return None
        return f"99 % of the answers take up to {latency.p99_ms:.2f} ms, expected {limit_ms:g} ms"

    @property
    def overload(self) -> str | None:
        """How far --rate is more than this machine answers; None: it keeps up."""
        if self.options.rate is None or len(self.predictions) < 2:
            return None
        ages_ms = self.times_ms("age")
        queued_ms = ages_ms[-1] - ages_ms[0] if ages_ms else 0.0
        if queued_ms <= _QUEUED * 1e3 / self.options.rate:
            return None
        return (
            f"{self.options.rate:g} frames a second are more than this machine answers "
            f"({self.frames_per_second:.1f}): the age of an answer grew by {queued_ms / 1e3:.1f} s"
        )

    @property
    def frames_per_second(self) -> float | None:
        """Rate of predicted frames, with reading and writing; None if none was predicted."""
        return len(self.predictions) / self.stream.wall_s if self.predictions else None

    @property
    def exit_code(self) -> int:
        """The first that applies: REASON_FOUND, DEADLINE_MISSED, FRAMES_SKIPPED, or 0.

        FRAMES_SKIPPED is also returned if the run was interrupted, or depth or poses are
        implausible.
        """
        if self.failed_on:
            return REASON_FOUND
        missed = self.statistics.missed
        if (missed is not None and missed.count) or self.p99_fault is not None:
            return DEADLINE_MISSED
        doubtful = any(self.implausible.values()) and self.records
        return FRAMES_SKIPPED if self.stream.interrupted or self.not_ok or doubtful else 0

    def document(self) -> dict[str, Any]:
        """Return the content of report.json, see REPORT_VERSION."""
        return {
            "format": REPORT_FORMAT,
            "version": REPORT_VERSION,
            **self.engine,
            "inputs": self.inputs,
            "output": str(self.out),
            "saved": self.saved,
            "depth_png": {
                "units_per_metre": METRES_PNG_SCALE,
                "max_m": METRES_PNG_MAX_M,
                "beyond": dict(self.beyond_png),
            },
            "frames": {
                "total": len(self.records),
                "by_status": self.by_status,
                "degraded": self.degraded,
                "health": self.health,
                "depth": self.depth_sources,
                "memory": self.memory,
                **self.implausible,
                "findings": [each.to_dict() for each in self.findings],
                "accepted": self.options.accepted,
                "readings": self._readings(),
                "by_network_size": self.by_network_size,
                "not_ok": [
                    {
                        "name": record.name,
                        "status": record.status,
                        "reason": record.reason,
                        "time_s": self.timeline and round(self.timeline.times_s[at], 3),
                    }
                    for at, record in enumerate(self.records)
                    if record.status != OK
                ],
            },
            "start_stamp_ns": self.timeline and self.timeline.start_ns,
            "duration_s": self.timeline and round(self.timeline.times_s[-1], 3),
            "outages": [each.to_dict() for each in self.outages],
            "failed_on": self.failed_on,
            "interrupted": self.stream.interrupted,
            "scenario": {
                "name": self.scenario,
                "rate_hz": self.options.rate,
                "overload": self.overload,
            },
            "deadline_p99": {"ms": self.options.deadline_p99_ms, "missed": self.p99_fault},
            **self.statistics.to_dict(),
            "wall_s": self.stream.wall_s,
            "frames_per_second": self.frames_per_second,
        }

    def _readings(self) -> dict[str, Any] | None:
        """The judgements: by camera if the cameras of a run have names."""
        judged = {name: each.to_dict() for name, each in self.judgements.items() if each.frames}
        return judged.get("", judged) or None


def size_text(size: tuple[int, int] | None) -> str:
    """A (height, width) in words; None stands for any size."""
    return "any size" if size is None else f"{size[0]} x {size[1]}"


def write_report(report: RunReport) -> None:
    """Write frames.csv and report.json into the run's folder. Raises OutputError."""
    # File names need not be valid text.
    table = with_flags(frames_csv(report)).encode(errors="surrogateescape")
    atomic_write(report.out / FRAMES_FILE, table)
    # The report is written last, so a folder with report.json is complete.
    document = with_flags(json.dumps(report.document(), indent=2, allow_nan=False))
    atomic_write(report.out / REPORT_FILE, (document + "\n").encode())


def frames_csv(report: RunReport) -> str:
    """One row per frame, with times in ms; cells that do not apply are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["index", "name", "status", "reason", "height", "width"]
        + [f"{stage}_ms" for stage in STAGES]
        + ["missed_deadline", "degraded", *(each.name for each in fields(Cleaned))]
        + ["depth_returns", "network_height", "network_width"]
        + ["image_stamp_ns", "depth_stamp_ns", "health", "depth_source", "depth_motion"]
        + ["memory_returns", "memory_rejected", "memory_off"]
    )
    for index, record in enumerate(report.records):
        met, answer, result = record.deadline_met, record.prediction, record.result
        memory: list[Any] = [0, "", ""]
        if result is not None:
            rejected = _cell(result.memory_rejected, ".4f")
            memory = [result.memory_returns, rejected, result.memory_off]
        writer.writerow(
            [index, record.name, record.status, record.reason]
            + list(answer.frame_size if answer else ("", ""))
            + [_cell(record.times_ms.get(stage), ".3f") for stage in STAGES]
            + ["" if met is None else int(not met), ";".join(record.degraded)]
            + list(asdict(answer.cleaned if answer else Cleaned()).values())
            + [answer.depth_returns if answer else 0]
            + list(answer.network_size if answer else ("", ""))
            + [record.image_stamp_ns, record.depth_stamp_ns, ";".join(record.health)]
            + [record.depth_source, result.depth_motion if result else "", *memory]
        )
    return text.getvalue()


def _cell(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def describe_run(report: RunReport) -> str:
    """The table of stages, with the counts and figures around it."""
    counts = ", ".join(f"{count} {status}" for status, count in report.by_status.items())
    interrupted = ", interrupted" if report.stream.interrupted else ""
    lines = [f"frames: {len(report.records)} ({counts}){interrupted}"]
    not_ok = ((record.name, f"{record.status}: {record.reason}") for record in report.not_ok)
    lines += [f"  {line}" for line in group_reasons(not_ok)]
    lines += [f"  degraded: {reason}: {count}" for reason, count in report.degraded.items()]
    lines += [f"  health: {reason}: {count}" for reason, count in report.health.items()]
    lines += [f"memory: {report.memory}"] if report.memory else []
    lines += [f"warning: {each.text}" for each in report.outages]
    if (poses := report.implausible[IMPLAUSIBLE_POSES]) is not None:
        lines.append(f"warning: {poses}")
    lines += [f"failed on {reason}: {count}" for reason, count in report.failed_on.items()]
    lines += [
        f"  warning: {count:,} pixels of {kind} are beyond {METRES_PNG_MAX_M:.2f} m, saved as "
        "65535: no measurement; to have their values, use the arrays of Python"
        for kind, count in report.beyond_png.items()
        if count
    ]
    if report.options.rate is not None:
        lines.append(f"constant stream of {report.options.rate:g} Hz")
    lines += [f"warning: {each}" for each in (report.p99_fault, report.overload) if each]
    lines += ["", report.statistics.table(), ""]
    rate, first_ms = report.frames_per_second, report.engine["first_inference_ms"]
    lines.append(f"frames a second, end to end: {'n/a' if rate is None else f'{rate:.1f}'}")
    load = f"load {report.engine['load_ms']:.0f} ms"
    first = "n/a" if first_ms is None else f"{first_ms:.1f} ms"
    lines.append(f"{load}, first inference {first} (not in the table)")
    return "\n".join(lines)


def group_reasons(frames: Iterable[tuple[str, str]]) -> Iterator[str]:
    """One line per reason; reasons that differ only in the name of the frame are merged."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, reason in frames:
        groups.setdefault(reason.replace(name, ""), []).append((name, reason))
    for (name, reason), *others in groups.values():
        yield f"{len(others) + 1} frames, first {name}: {reason}" if others else f"{name}: {reason}"


def list_results(report: RunReport) -> Iterator[str]:
    """Lines that say where the results are."""
    options = report.options
    yield f"results: {os.path.realpath(report.out)}"
    if options.record is not None:
        yield f"reference: {os.path.realpath(options.record)}"
    for camera, inputs in report.inputs.get("cameras", {"": report.inputs}).items():
        each = options.of_camera(camera)
        for option, path in each.named_files.items():
            if path.exists():
                yield f"{option}: {os.path.realpath(path)}"
                if option == "mcap":
                    origin = inputs["frames_from"] or "no place of the LiDAR"
                    yield f"  in the frame {inputs['camera_frame']}, with {origin}"
        if OVERLAY in report.saved and report.by_status["ok"]:
            yield f"pictures: {os.path.realpath(each.folder / OVERLAY)}"
