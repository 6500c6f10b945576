"""`ssdnet-verify`: predict the frames of a reference again, and compare the answers."""

# ruff: noqa: RUF009 - what is called in `VerifyOptions` returns a field

import math
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass
from pathlib import Path
from typing import Any

import typer

from runtime.base.arguments import shown
from runtime.command.json_file import STDOUT, require_json, write_json
from runtime.command.options import Provider, UsageError, option_group, read_options, with_options
from runtime.command.process import print_result, reported_errors
from runtime.contract.agreement import figure_name
from runtime.contract.heads import HEADS
from runtime.engine.predictor import Predictor
from runtime.verification.reference import read_reference
from runtime.verification.unpack import MANIFEST_FILE, unpack
from runtime.verification.verify import Figures, VerifyReport, verify

DIFFERS = 4  # exit code
_TIMES = ("median_ms", "max_latency_ms", "slowdown", "max_slowdown")  # of the document
_option = option_group()


def _tolerances(texts: Sequence[str]) -> dict[str, dict[str, float]]:
    """The limits by head and figure; "" stands for the first figure. Raises UsageError."""
    limits: dict[str, dict[str, float]] = {}
    for text in texts:
        name, _, number = text.partition("=")
        head, _, short = name.partition(".")
        try:
            limit = float(number)
        except ValueError:
            limit = -1
        if not 0 <= limit < math.inf:
            raise UsageError(
                "--tolerance is HEAD=LIMIT or HEAD.FIGURE=LIMIT, as depth=0.01 or depth.mean=0.2, "
                f"got {shown(text)}"
            )
        try:
            figure = figure_name(head, short) if short and head in HEADS else ""
        except ValueError as error:
            raise UsageError(f"--tolerance {text}: {error}") from error
        limits.setdefault(head, {})[figure] = limit
    return limits


@dataclass(frozen=True)
class VerifyOptions:
    """The options of `ssdnet-verify`."""

    reference_dir: Path = _option(
        "Reference made by ssdnet-run --record or ssdnet-export --record.",
        default=MISSING,
        kind=typer.Argument,
        metavar="DIR",
    )
    model: str | None = _option(
        "Model to compare with the recorded answers. [default: the recorded model]",
        metavar="NAME|PATH",
    )
    provider: Provider = _option("Execution provider of the model.", default=Provider.cpu)
    threads: int | None = _option("Threads of inference. [default: physical cores]", min=1)
    tolerance: Figures | None = _option(
        "Limit of a head, instead of its recorded ones; may be repeated. semantic.equal is the "
        "least share of equal pixels. The other heads have .mean, .max and percentiles (.p99) of "
        "the difference, in metres for depths, and relative to the scores for semantic_logits. "
        "Without a figure, LIMIT is that of semantic.equal, of boundary.mean, or else of .max.",
        given=list[str] | None,
        read=_tolerances,
        metavar="HEAD[.FIGURE]=LIMIT",
    )
    max_slowdown: float = _option(
        "Largest ratio of the median prediction time to the recorded one.",
        default=math.inf,
        min=1e-6,
        show_default="times are not compared",
    )
    max_latency_ms: float = _option(
        "Largest median prediction time.", default=math.inf, min=1e-6, show_default="no limit"
    )
    json_file: Path | None = _option(
        "Write the comparison as one JSON document; - prints it instead of the table.",
        "--json",
        metavar="FILE",
    )
    unpack_dir: Path | None = _option(
        "Write frames and answers as .npy files with a manifest for other languages, and compare "
        "nothing.",
        "--unpack",
        metavar="DIR",
    )
    overwrite: bool = _option(
        "Replace an earlier folder of --unpack, and the file of --json.",
        "--overwrite",
        default=False,
    )

    def __post_init__(self) -> None:
        """Raise UsageError if options contradict each other."""
        if self.unpack_dir is not None and self.model is not None:
            raise UsageError("--unpack writes the recorded answers: leave out --model")


app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    "verify",
    epilog="Exit codes: 0 the same answers; 1 error; 2 usage; 4 an answer differs by more "
    "than its limit, --max-slowdown or --max-latency-ms was exceeded, or the reference holds no "
    "frames.",
)
@with_options(VerifyOptions)
def main(**given: Any) -> None:
    """Predict the frames of a reference again, and compare the answers with the recorded ones."""
    with reported_errors("cpu"):
        options = read_options(VerifyOptions, given)
        require_json(options.json_file, overwrite=options.overwrite)
        reference = read_reference(options.reference_dir)
        with Predictor(
            reference.model if options.model is None else options.model,
            sha256=reference.model_sha256 if options.model is None else None,
            provider=options.provider.value,
            size=reference.settings.size,
            focal_length_px=reference.settings.focal_length_px,
            threads=options.threads,
            warmup=0,
        ) as predictor:
            if (folder := options.unpack_dir) is not None:
                unpack(reference, predictor, folder, overwrite=options.overwrite)
                print_result(f"{len(reference.frames)} frames: {folder / MANIFEST_FILE}")
                return
            report = verify(
                predictor,
                reference,
                tolerances=options.tolerance or {},
                max_slowdown=options.max_slowdown,
                max_latency_ms=options.max_latency_ms,
            )
        write_json(options.json_file, _to_json(report, predictor), overwrite=options.overwrite)
        if options.json_file != STDOUT:
            print_result(_table(report, predictor))
        raise typer.Exit(0 if report.passed else DIFFERS)


def _table(report: VerifyReport, predictor: Predictor) -> str:
    """One line per limit with the worst value over all frames, then one line per other fault."""
    reference, frames = report.reference, len(report.reference.frames)
    contract, is_same = predictor.contract, predictor.model.sha256 == reference.model_sha256
    now = f"now {contract.model_name} {contract.precision} sha256:{predictor.model.sha256[:12]}"
    software = reference.software
    by = f"{reference.settings.made_by} {software.get('ssdnet', '')}".strip()
    runtime = f", ONNX Runtime {software['onnxruntime']}" if "onnxruntime" in software else ""
    lines = [
        f"{frames} frames: {reference.model_name} sha256:{reference.model_sha256[:12]} by {by} on "
        f"{reference.settings.provider}{runtime}",
        f"{now} on {predictor.provider}, {'' if is_same else 'NOT '}the recorded one",
        "",
        f"{'head':18}{'figure':14}{'worst':>12}{'limit':>12}{'frames beyond':>15}  worst frame",
    ]
    for row in report.figures:
        line = f"{row.head:18}{row.figure:14}"
        line += f"{'n/a':>12}" if row.worst is None else f"{row.worst:>12.6g}"
        line += f"{row.limit:>12.6g}{row.frames_beyond:>15}  {row.frame or ''}"
        lines.append(line.rstrip())
    times = [("x recorded", report.slowdown, report.max_slowdown, " times the recorded time", "")]
    if report.max_latency_ms < math.inf:
        median = report.median_ms, report.max_latency_ms
        times.append(("median ms", *median, " ms at the median", " ms"))
    for name, value, limit, *_ in times:
        if value is not None:
            lines.append(f"{'time':18}{name:14}{value:>12.3f}{limit:>12g}")
    for fault in report.faults:
        lines.append(f"  {fault.text} ({fault.frames} frames, the first is {fault.first_frame})")
    lines.append("")
    if not frames:
        lines.append("the reference holds no frames: nothing was compared")
    elif report.failed:
        lines.append(f"{report.failed} of {frames} frames differ from the reference")
    elif is_same:
        lines.append("the same answers")
    else:
        lines.append("the recorded answers, within the limits")
    for _, value, limit, of, unit in times:
        if value is not None and value > limit:
            took = f"predictions take {value:.3f}{of}"
            lines.append(f"{took}, expected at most {limit:g}{unit}")
    return "\n".join(lines)


def _to_json(report: VerifyReport, predictor: Predictor) -> dict[str, Any]:
    """The content of the table for a program; null if a value is missing or not finite."""
    reference, contract = report.reference, predictor.contract
    return {
        "passed": report.passed,
        "frames": len(reference.frames),
        "frames_beyond": report.failed,
        "recorded": {
            "model": reference.model_name,
            "sha256": reference.model_sha256,
            "made_by": reference.settings.made_by,
            "provider": reference.settings.provider,
            "software": dict(reference.software),
        },
        "now": {
            "model": contract.model_name,
            "precision": contract.precision,
            "sha256": predictor.model.sha256,
            "provider": predictor.provider,
        },
        "figures": [
            {key: _finite(value) for key, value in asdict(row).items()} for row in report.figures
        ],
        "faults": [asdict(fault) for fault in report.faults],
        **{name: _finite(getattr(report, name)) for name in _TIMES},
    }


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
