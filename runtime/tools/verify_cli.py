"""`ssdnet-verify`: compare the present answers with those of a recording."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.checks import check_number, shown
from runtime.command import ERROR, Provider, print_result, reported_errors
from runtime.command_options import NoDevice, Version
from runtime.io.recording import read_recording
from runtime.predictor import Predictor
from runtime.tools.verify import FrameCheck, VerifyReport, verify

DIFFERS = 4  # exit code

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    "verify",
    epilog="Exit codes: 0 the same answers; 1 error; 2 usage; 4 an answer differs by more "
    "than its limit, --max-slowdown was exceeded, or the recording holds no frames.",
)
def main(
    recording_dir: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="Recording made by ssdnet-run --record or ssdnet-export --record."
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|PATH",
            help="Model to compare with the recorded answers. [default: the recorded model]",
        ),
    ] = None,
    provider: Annotated[
        Provider, typer.Option(help="Execution provider of the model.")
    ] = Provider.cpu,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HEAD=LIMIT",
            help="Limit of a head, instead of the recorded one; may be repeated. semantic: "
            "minimum share of equal pixels; boundary: mean difference; others: largest difference "
            "(metres; for semantic_logits relative to the largest score).",
        ),
    ] = None,
    max_slowdown: Annotated[
        float | None,
        typer.Option(
            help="Largest ratio of the median prediction time to the recorded one. "
            "[default: times are not compared]"
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON document instead of the tables.")
    ] = False,
    _device: NoDevice = None,
    _version: Version = False,
) -> None:
    """Predict the frames of a recording again, and compare the answers with the recorded ones."""
    tolerances = _tolerances(tolerance or [])
    if max_slowdown is not None:
        check_number("--max-slowdown", max_slowdown, 1e-6, 1e6, error=typer.BadParameter)
    with reported_errors("cpu"):
        recording = read_recording(recording_dir)
        with Predictor(
            recording.model if model is None else model,
            sha256=recording.model_sha256 if model is None else None,
            provider=provider.value,
            size=recording.settings.size,
            focal_length_px=recording.settings.focal_length_px,
            threads=threads,
            warmup=0,
        ) as predictor:
            report = verify(predictor, recording, tolerances=tolerances, max_slowdown=max_slowdown)
        if not print_result(_json(report.document()) if as_json else _table(report)):
            raise typer.Exit(ERROR)
        raise typer.Exit(0 if report.passed else DIFFERS)


def _tolerances(texts: Sequence[str]) -> dict[str, float]:
    limits = {}
    for text in texts:
        head, _, number = text.partition("=")
        try:
            limits[head] = float(number)
        except ValueError:
            limits[head] = math.nan
        if not 0 <= limits[head] < math.inf:
            raise typer.BadParameter(f"--tolerance is HEAD=LIMIT, as depth=0.01, got {shown(text)}")
    return limits


def _json(document: dict[str, Any]) -> str:
    """The document as JSON text, with null for NaN, which JSON does not have."""
    for frame in document["frames"]:
        for figures in frame["figures"].values():
            figures.update({n: None for n, value in figures.items() if not math.isfinite(value)})
    return json.dumps(document, indent=2, allow_nan=False)


def _table(report: VerifyReport) -> str:
    """One line per head with its worst value over all frames, then one line per difference."""
    settings, checks = report.recording.settings, report.checks
    same = "the recorded one" if report.same_model else "NOT the recorded one"
    lines = [
        f"{len(checks)} frames of {settings.made_by} on {settings.provider}, now on "
        f"{report.provider}",
        f"{report.model} sha256:{report.sha256[:12]}, {same}",
        "",
        f"{'head':18}{'figure':14}{'worst':>12}{'limit':>12}",
    ]
    for head, limits in report.limits.items():
        figures = report.worst(head) or {}
        for name, limit in limits.items():
            worst = f"{figures[name]:.6g}" if figures else "n/a"
            lines.append(f"{head:18}{name:14}{worst:>12}{limit:>12.6g}")
    if report.slowdown is not None:
        limit_text = "no limit" if report.max_slowdown is None else f"{report.max_slowdown:g}"
        lines.append(f"{'time':18}{'x recorded':14}{report.slowdown:>12.3f}{limit_text:>12}")
    lines.append("")
    lines += [line for check in report.failed for line in _differences(check, report.limits)]
    if not checks:
        lines.append("the recording holds no frames: nothing was compared")
    elif report.failed:
        lines.append(f"{len(report.failed)} of {len(checks)} frames differ from the recording")
    else:
        lines.append("the same answers")
    if report.slow:
        lines.append(
            f"predictions take {report.slowdown:.3f} times the recorded time, expected at most "
            f"{report.max_slowdown:g}"
        )
    return "\n".join(lines)


def _differences(check: FrameCheck, limits: Mapping[str, Mapping[str, float]]) -> list[str]:
    name = check.frame.name
    lines = [f"  {name}: {fault}" for fault in check.faults]
    for head in check.failed:
        figures = ", ".join(f"{key} {value:.6g}" for key, value in check.figures[head].items())
        limit = ", ".join(f"{key} {value:.6g}" for key, value in limits[head].items())
        lines.append(f"  {name}: {head}: {figures} (limit {limit})")
    return lines
