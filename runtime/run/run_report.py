"""What a run of a stream comes to: a row a frame (frames.csv) and the whole (report.json)."""

import csv
import io
import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from runtime.engine_facts import engine_facts
from runtime.io.encode import METRES_PNG_MAX_M, METRES_PNG_SCALE
from runtime.predictor import Predictor
from runtime.run.pipeline import SKIPPED, FrameRecord, StreamResult
from runtime.sync.latency import (
    LatencyStatistics,
    MissCounter,
    MissedDeadlines,
    latency_statistics,
    latency_table,
)

REPORT_FORMAT, REPORT_VERSION = "ssdnet-run", "1.6"

# "predict" is Predictor.predict from end to end; "age" and "jitter" are of constant streams, "skew"
# of sources whose sensors both have stamps.
STAGES: dict[str, Callable[[FrameRecord], float | None]] = {
    "read": lambda record: record.read_ms,
    "preprocess": lambda record: record.latency.preprocess_ms if record.latency else None,
    "inference": lambda record: record.latency.inference_ms if record.latency else None,
    "postprocess": lambda record: record.latency.postprocess_ms if record.latency else None,
    "predict": lambda record: record.latency.total_ms if record.latency else None,
    "write": lambda record: record.write_ms,
    "age": lambda record: record.age_ms,
    "jitter": lambda record: record.jitter_ms,
    "skew": lambda record: record.skew_ms,
}
_CONSTANT_STREAM = ("age", "jitter")


def stage_statistics(result: StreamResult) -> dict[str, LatencyStatistics | None]:
    """Statistics of every stage of the scenario over the frames that went through it."""
    left_out: tuple[str, ...] = () if result.rate_hz is not None else _CONSTANT_STREAM
    if all(record.skew_ms is None for record in result.records):
        left_out += ("skew",)
    return {
        stage: latency_statistics(
            time_ms for time_ms in map(time_of, result.records) if time_ms is not None
        )
        for stage, time_of in STAGES.items()
        if stage not in left_out
    }


def missed(records: Sequence[FrameRecord], deadline_ms: float | None) -> MissedDeadlines | None:
    """The answers that took longer than the deadline, by `response_ms`; None without a deadline."""
    if deadline_ms is None:
        return None
    counter = MissCounter()
    for record in records:
        if record.response_ms is not None:
            counter.record(late=record.response_ms > deadline_ms)
    return counter.misses()


def frames_csv(records: Sequence[FrameRecord], *, deadline_ms: float | None) -> str:
    """A row a frame; times in ms; cells that do not apply are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["index", "name", "status", "reason", "height", "width"]
        + [f"{stage}_ms" for stage in STAGES]
        + ["missed_deadline", "degraded", "nan", "infinite", "negative", "too_far"]
        + ["depth_returns", "network_height", "network_width"]
        + ["image_stamp_ns", "depth_stamp_ns"]
    )
    for record in records:
        times = (time_of(record) for time_of in STAGES.values())
        late: int | str = ""
        if deadline_ms is not None and record.response_ms is not None:
            late = int(record.response_ms > deadline_ms)
        writer.writerow(
            [record.index, record.name, record.status, record.reason]
            + list(record.frame_size or ("", ""))
            + ["" if time_ms is None else f"{time_ms:.3f}" for time_ms in times]
            + [late, ";".join(record.degraded)]
            + [*asdict(record.cleaned).values(), record.depth_returns]
            + list(record.network_size or ("", ""))
            + [record.image_stamp_ns, record.depth_stamp_ns]
        )
    return text.getvalue()


def build_report(
    predictor: Predictor,
    result: StreamResult,
    *,
    inputs: dict[str, Any],
    output: str,
    kinds: Sequence[str],
    deadline_ms: float | None,
) -> dict[str, Any]:
    """The whole run as one JSON document, see REPORT_VERSION.

    inputs: where the frames came from, as the user gave it.
    kinds: what was written of each frame, of `runtime.run.run_folder.KINDS`.
    """
    records = result.records
    late = missed(records, deadline_ms)
    return {
        "format": REPORT_FORMAT,
        "version": REPORT_VERSION,
        **asdict(engine_facts(predictor)),
        "inputs": inputs,
        "output": output,
        "saved": kinds,
        "depth_png": {"units_per_metre": METRES_PNG_SCALE, "max_m": METRES_PNG_MAX_M},
        "frames": {
            "total": len(records),
            "by_status": dict(Counter(record.status for record in records)),
            "degraded": dict(Counter(reason for record in records for reason in record.degraded)),
            "by_network_size": dict(
                Counter(_size(record.network_size) for record in records if record.network_size)
            ),
            "not_ok": [
                {"name": record.name, "status": record.status, "reason": record.reason}
                for record in records
                if record.reason
            ],
        },
        "interrupted": result.interrupted,
        "scenario": {
            "name": "single-stream" if result.rate_hz is None else "constant-stream",
            "rate_hz": result.rate_hz,
        },
        "stages": {
            stage: None if statistics is None else asdict(statistics)
            for stage, statistics in stage_statistics(result).items()
        },
        "wall_s": result.wall_s,
        "frames_per_second": frames_per_second(result),
        "deadline": None if late is None else {"deadline_ms": deadline_ms, **asdict(late)},
    }


def frames_per_second(result: StreamResult) -> float | None:
    """Frames predicted a second, end to end: reading and writing included."""
    predicted = sum(record.status != SKIPPED for record in result.records)
    return predicted / result.wall_s if predicted else None


def to_json(report: dict[str, Any]) -> str:
    """The report as text."""
    return json.dumps(report, indent=2, allow_nan=False) + "\n"


def describe_predictor(predictor: Predictor, frame_size: tuple[int, int] | None) -> str:
    """One line: model and digest; what runs it, threads, sizes.

    frame_size: (height, width) of the frames, or None if not known.
    """
    network_size = predictor.network_size(frame_size) if frame_size else predictor.input_size
    nodes = predictor.node_counts
    running = ", ".join(
        name if nodes is None else f"{name} {nodes.get(name, 0)} nodes"
        for name in predictor.providers
        if nodes is None or name in nodes or name == predictor.providers[0]
    )
    return (
        f"{predictor.contract.model_name} sha256:{predictor.digest[:12]} | {running} | "
        f"threads {predictor.threads} | frames {_size(frame_size)}, "
        f"network at {_size(network_size)}"
    )


def describe_run(result: StreamResult, report: dict[str, Any]) -> str:
    """The table of stages and what stands around it, for people."""
    frames = report["frames"]
    counts = ", ".join(f"{count} {status}" for status, count in frames["by_status"].items())
    lines = [
        f"frames: {frames['total']} ({counts})" + (", interrupted" if result.interrupted else "")
    ]
    lines += [
        f"  {entry['name']}: {entry['status']}: {entry['reason']}" for entry in frames["not_ok"]
    ]
    lines += [f"  degraded: {reason}: {count}" for reason, count in frames["degraded"].items()]
    if result.rate_hz is not None:
        lines.append(f"constant stream of {result.rate_hz:g} Hz")
    lines += ["", latency_table(stage_statistics(result)), ""]
    rate = report["frames_per_second"]
    lines.append(f"frames a second, end to end: {'n/a' if rate is None else f'{rate:.1f}'}")
    first_ms = report["first_inference_ms"]
    lines.append(
        f"load {report['load_ms']:.0f} ms, first inference "
        + ("n/a" if first_ms is None else f"{first_ms:.1f} ms")
        + " (not in the table)"
    )
    if deadline := report["deadline"]:
        lines.append(
            f"missed deadlines of {deadline['deadline_ms']:g} ms: {deadline['count']}, "
            f"longest run {deadline['longest_run']}"
        )
    reach_m, limit_m = report["model"]["max_depth_m"], report["depth_png"]["max_m"]
    if "depth" in report["saved"] and reach_m > limit_m:
        lines.append(
            f"note: the model's depth reaches {reach_m:g} m, a depth PNG {limit_m:.2f} m: what is "
            f"beyond says {limit_m:.2f} m"
        )
    return "\n".join(lines)


def _size(size: tuple[int, int] | None) -> str:
    return "of any size" if size is None else f"{size[0]} x {size[1]}"
