"""The files of a run's report, and its tables for people."""

import csv
import io
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict

from runtime.io.atomic_write import atomic_write
from runtime.io.encode import METRES_PNG_MAX_M
from runtime.prediction import Cleaned
from runtime.predictor import Predictor
from runtime.run.options import RunOptions
from runtime.run.run_folder import FRAMES_FILE, OVERLAY, REPORT_FILE
from runtime.run.run_report import STAGES, RunReport, depth_source, size_text


def write_report(report: RunReport) -> None:
    """Write frames.csv and report.json into the run's folder. Raises OutputError."""
    # File names need not be valid text.
    table = frames_csv(report).encode(errors="surrogateescape")
    atomic_write(report.out / FRAMES_FILE, table)
    # Written last: a folder with report.json is complete.
    document = json.dumps(report.document(), indent=2, allow_nan=False)
    atomic_write(report.out / REPORT_FILE, (document + "\n").encode())


def frames_csv(report: RunReport) -> str:
    """One row per frame; times in ms; cells that do not apply are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["index", "name", "status", "reason", "height", "width"]
        + [f"{stage}_ms" for stage in STAGES]
        + ["missed_deadline", "degraded", "nan", "infinite", "negative", "too_far"]
        + ["depth_returns", "network_height", "network_width"]
        + ["image_stamp_ns", "depth_stamp_ns", "health", "depth_source", "depth_motion"]
    )
    for record in report.records:
        times_ms = (time_of(record) for time_of in STAGES.values())
        met, answer = record.deadline_met, record.prediction
        writer.writerow(
            [record.sequence, record.name, record.status, record.reason]
            + list(answer.frame_size if answer else ("", ""))
            + ["" if time_ms is None else f"{time_ms:.3f}" for time_ms in times_ms]
            + ["" if met is None else int(not met), ";".join(answer.degraded if answer else ())]
            + list(asdict(answer.cleaned if answer else Cleaned()).values())
            + [answer.depth_returns if answer else 0]
            + list(answer.network_size if answer else ("", ""))
            + [record.image_stamp, record.depth_stamp, ";".join(record.health)]
            + [depth_source(record), record.depth_motion]
        )
    return text.getvalue()


def describe_predictor(predictor: Predictor, frame_size: tuple[int, int] | None) -> str:
    """Lines on model, providers, threads, sizes of frames and network, focal length and range."""
    network_size = None
    if frame_size or not predictor.free_size:
        network_size = predictor.network_size(frame_size or predictor.contract.native_size)
    nodes = predictor.node_counts
    running = ", ".join(
        name if nodes is None else f"{name} {nodes.get(name, 0)} nodes"
        for name in predictor.providers
        if nodes is None or name in nodes or name == predictor.providers[0]
    )
    return (
        f"{predictor.contract.model_name} sha256:{predictor.digest[:12]} | {running} | "
        f"threads {predictor.threads} | frames {size_text(frame_size)}, "
        f"network at {size_text(network_size)}{_scale_text(predictor, frame_size)}"
    )


def _scale_text(predictor: Predictor, frame_size: tuple[int, int] | None) -> str:
    if frame_size is None:
        return ""
    scale = predictor.camera_scale(frame_size)
    given_px = predictor.focal_length_px
    used = "not known: give --focal-length" if given_px is None else f"{given_px:g} px"
    if scale.focal_length_px is None and given_px is not None:
        used += ", not used by this model"
    return f"\nfocal length {used}; depth up to {scale.range_m:.4g} m"


def describe_run(report: RunReport) -> str:
    """The table of stages, and the counts and figures around it."""
    counts = ", ".join(f"{count} {status}" for status, count in report.by_status.items())
    interrupted = ", interrupted" if report.stream.interrupted else ""
    lines = [f"frames: {len(report.records)} ({counts}){interrupted}"]
    not_ok = ((record.name, f"{record.status}: {record.reason}") for record in report.not_ok)
    lines += [f"  {line}" for line in group_reasons(not_ok)]
    lines += [f"  degraded: {reason}: {count}" for reason, count in report.degraded.items()]
    lines += [f"  health: {reason}: {count}" for reason, count in report.health.items()]
    if report.stream.rate_hz is not None:
        lines.append(f"constant stream of {report.stream.rate_hz:g} Hz")
    lines += ["", report.statistics.table(), ""]
    rate, first_ms = report.frames_per_second, report.engine.first_inference_ms
    lines.append(f"frames a second, end to end: {'n/a' if rate is None else f'{rate:.1f}'}")
    lines.append(
        f"load {report.engine.load_ms:.0f} ms, first inference "
        + ("n/a" if first_ms is None else f"{first_ms:.1f} ms")
        + " (not in the table)"
    )
    range_m = report.engine.model.max_depth_m
    if "depth" in report.saved and range_m > METRES_PNG_MAX_M:
        lines.append(
            f"note: the model's depth reaches {range_m:g} m, a depth PNG {METRES_PNG_MAX_M:.2f} m: "
            f"depth beyond is stored as {METRES_PNG_MAX_M:.2f} m"
        )
    return "\n".join(lines)


def group_reasons(frames: Iterable[tuple[str, str]]) -> Iterator[str]:
    """A line for each reason; reasons that differ only in the name of the frame are merged."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, reason in frames:
        groups.setdefault(reason.replace(name, ""), []).append((name, reason))
    for (name, reason), *others in groups.values():
        yield f"{len(others) + 1} frames, first {name}: {reason}" if others else f"{name}: {reason}"


def list_results(report: RunReport, options: RunOptions) -> Iterator[str]:
    """Lines that say where the results are."""
    yield f"results: {os.path.realpath(report.out)}"
    if options.record is not None:
        yield f"recording: {os.path.realpath(options.record)}"
    cameras = report.inputs.get("cameras", ())
    for each in [options.of_camera(camera) for camera in cameras] or [options]:
        for option, path in each.named_files.items():
            if path.exists():
                yield f"{option}: {os.path.realpath(path)}"
        if OVERLAY in report.saved and report.by_status["ok"]:
            yield f"pictures: {os.path.realpath(each.folder / OVERLAY)}"
