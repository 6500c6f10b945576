"""`ssdnet-verify`: does a recording's model still give the answers that were recorded?"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.command import ERROR, Provider, reported_errors, say
from runtime.errors import InputError
from runtime.io.recording import Recording, read_recording
from runtime.predictor import Predictor
from runtime.tools.verify import FrameCheck, slowdown, verify, worst_figures

VERIFY_FORMAT, VERIFY_VERSION = "ssdnet-verify", "1.0"
DIFFERS = 4  # exit code

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    "verify",
    epilog="Exit codes: 0 the same answers; 1 error; 2 usage; 4 a frame's answers differ by more "
    "than their limit, or --max-slowdown was exceeded.",
)
def run(
    recording_dir: Annotated[
        Path,
        typer.Argument(
            metavar="DIR", help="A recording, of ssdnet-run --record or ssdnet-export --record."
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|PATH",
            help="Another model, to be held against the recorded answers. [default: the model in "
            "the recording]",
        ),
    ] = None,
    provider: Annotated[Provider, typer.Option(help="What runs the model.")] = Provider.cpu,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HEAD=LIMIT",
            help="Limit of a head in place of the recording's, more than once: the least share of "
            "equal pixels for semantic, the largest difference for others (metres, probability; "
            "share of the largest score for semantic_logits).",
        ),
    ] = None,
    max_slowdown: Annotated[
        float | None,
        typer.Option(
            help="Fail where the median prediction takes more than so many times the recorded one. "
            "[default: times are not compared]"
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON document instead of the tables.")
    ] = False,
) -> None:
    """Predict a recording's frames again, and compare every answer with the recorded one."""
    asked = _tolerances(tolerance or [])
    if max_slowdown is not None and not 0 < max_slowdown < math.inf:
        raise typer.BadParameter(f"--max-slowdown must be more than 0, got {max_slowdown}")
    with reported_errors("cpu"):
        recording = read_recording(recording_dir)
        if unknown := sorted(asked.keys() - recording.limits.keys()):
            raise InputError(
                f"--tolerance names {', '.join(unknown)}, the recording holds "
                f"{', '.join(recording.limits)}"
            )
        limits = {**recording.limits, **asked}
        with Predictor(
            recording.model if model is None else model,
            sha256=recording.model_sha256 if model is None else None,
            provider=provider.value,
            size=recording.settings.size,
            focal_length_px=recording.settings.focal_length_px,
            threads=threads,
            warmup=0,
        ) as predictor:
            checks = list(verify(predictor, recording, limits))
        factor = slowdown(checks)
        if max_slowdown is not None and factor is None:
            raise InputError(
                "--max-slowdown needs times, and this recording has none: record with ssdnet-run"
            )
        slow = max_slowdown is not None and factor is not None and factor > max_slowdown
        document = {
            "format": VERIFY_FORMAT,
            "version": VERIFY_VERSION,
            "passed": not slow and all(check.passed for check in checks),
            "recording": str(recording_dir),
            "made_by": recording.settings.made_by,
            "recorded_on": recording.settings.provider,
            "provider": provider.value,
            "model": predictor.contract.model_name,
            "sha256": predictor.digest,
            "same_model": predictor.digest == recording.model_sha256,
            "limits": limits,
            "slowdown": factor,
            "max_slowdown": max_slowdown,
            "frames": [{**asdict(check), "passed": check.passed} for check in checks],
        }
        text = _json(document) if as_json else _table(document, recording, checks)
        if not say(text):
            raise typer.Exit(ERROR)
        raise typer.Exit(0 if document["passed"] else DIFFERS)


def _tolerances(texts: Sequence[str]) -> dict[str, float]:
    limits = {}
    for text in texts:
        head, _, number = text.partition("=")
        try:
            limits[head] = float(number)
        except ValueError:
            limits[head] = math.nan
        if not 0 <= limits[head] < math.inf:
            raise typer.BadParameter(f"--tolerance is HEAD=LIMIT, as depth=0.01, got {text!r:.80}")
    return limits


def _json(document: dict[str, Any]) -> str:
    """JSON knows no NaN: a figure that is none is null, and its frame has not passed."""
    for frame in document["frames"]:
        for figures in frame["figures"].values():
            figures.update({n: None for n, value in figures.items() if not math.isfinite(value)})
    return json.dumps(document, indent=2, allow_nan=False)


def _table(document: Mapping[str, Any], recording: Recording, checks: Sequence[FrameCheck]) -> str:
    """A line a head with the worst of all frames, then a line for each thing that differs."""
    same = "the recorded one" if document["same_model"] else "NOT the recorded one"
    lines = [
        f"{len(checks)} frames of {document['made_by']} on {document['recorded_on']}, now on "
        f"{document['provider']}",
        f"{document['model']} sha256:{document['sha256'][:12]}, {same}",
        "",
        f"{'head':18}{'figure':14}{'worst':>12}{'limit':>12}",
    ]
    for head, limit in document["limits"].items():
        figures = worst_figures(checks, head)
        name, value = next(iter(figures.items())) if figures else ("", None)
        shown = "n/a" if value is None else f"{value:.6g}"
        lines.append(f"{head:18}{name:14}{shown:>12}{limit:>12.6g}")
    factor, most = document["slowdown"], document["max_slowdown"]
    if factor is not None:
        asked = "not asked" if most is None else f"{most:g}"
        lines.append(f"{'time':18}{'x recorded':14}{factor:>12.3f}  {asked:>10}")
    lines.append("")
    failed = [check for check in checks if not check.passed]
    lines += [line for check in failed for line in _differences(check, document["limits"])]
    slow = factor is not None and most is not None and factor > most
    lines.append(
        "the same answers"
        if not failed
        else f"{len(failed)} of {len(checks)} frames differ from the recording"
    )
    if slow:
        lines.append(f"predictions take {factor:.3f} times what was recorded, at most {most:g}")
    return "\n".join(lines)


def _differences(check: FrameCheck, limits: Mapping[str, float]) -> list[str]:
    name = check.frame.name
    lines = [f"  {name}: {fault}" for fault in check.faults]
    for head in check.failed:
        figures = ", ".join(f"{key} {value:.6g}" for key, value in check.figures[head].items())
        lines.append(f"  {name}: {head}: {figures} (limit {limits[head]:.6g})")
    return lines
