"""`ssdnet-verify`: compare the present answers with those of a recording."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from runtime.checks import check_number, shown
from runtime.command import ERROR, Provider, print_result, reported_errors
from runtime.command_options import Version
from runtime.io.recording import read_recording
from runtime.predictor import Predictor
from runtime.tools.verify import VerifyReport, verify

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
        if not print_result(_table(report, predictor)):
            raise typer.Exit(ERROR)
        raise typer.Exit(0 if report.passed else DIFFERS)


def _tolerances(texts: Sequence[str]) -> dict[str, float]:
    limits = {}
    for text in texts:
        head, _, number = text.partition("=")
        try:
            limits[head] = float(number)
        except ValueError:
            limits[head] = -1
        if not limits[head] >= 0:
            raise typer.BadParameter(f"--tolerance is HEAD=LIMIT, as depth=0.01, got {shown(text)}")
    return limits


def _table(report: VerifyReport, predictor: Predictor) -> str:
    """One line per head with its worst value over all frames, then one line per difference."""
    recording, checks, failed = report.recording, report.checks, report.failed
    same = "" if predictor.digest == recording.model_sha256 else "NOT "
    lines = [
        f"{len(checks)} frames of {recording.settings.made_by} on {recording.settings.provider}, "
        f"now on {predictor.provider}",
        f"{predictor.contract.model_name} sha256:{predictor.digest[:12]}, {same}the recorded one",
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
    lines += ["", *(f"  {check.name}: {fault}" for check in failed for fault in check.faults)]
    if not checks:
        lines.append("the recording holds no frames: nothing was compared")
    elif failed:
        lines.append(f"{len(failed)} of {len(checks)} frames differ from the recording")
    else:
        lines.append("the same answers")
    if report.slow:
        lines.append(
            f"predictions take {report.slowdown:.3f} times the recorded time, expected at most "
            f"{report.max_slowdown:g}"
        )
    return "\n".join(lines)
