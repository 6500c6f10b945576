"""`ssdnet-verify`: predict the frames of a recording again, and compare the answers."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import typer
from numpy.typing import NDArray

from runtime.app.command import Provider, print_result, reported_errors
from runtime.app.command_options import Version
from runtime.base.checks import shown
from runtime.base.errors import InferenceError, InputError
from runtime.contract.agreement import compare, first_figure, within, worst
from runtime.engine.predictor import Predictor
from runtime.recordings.recording import RecordedFrame, Recording, read_recording
from runtime.recordings.unpack import MANIFEST_FILE, unpack

DIFFERS = 4  # exit code
Figures = Mapping[str, Mapping[str, float]]  # head -> figure of `agreement.compare` -> value

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
        float,
        typer.Option(
            min=1e-6,
            show_default="times are not compared",
            help="Largest ratio of the median prediction time to the recorded one.",
        ),
    ] = math.inf,
    unpack_dir: Annotated[
        Path | None,
        typer.Option(
            "--unpack",
            metavar="DIR",
            help="Write frames and answers as .npy files with a manifest for other languages, and "
            "compare nothing.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an earlier folder of --unpack.")
    ] = False,
    _version: Version = False,
) -> None:
    """Predict the frames of a recording again, and compare the answers with the recorded ones."""
    tolerances = _tolerances(tolerance or [])
    if unpack_dir is not None and model is not None:
        raise typer.BadParameter("--unpack writes the recorded answers: leave out --model")
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
            if unpack_dir is not None:
                unpack(recording, predictor, unpack_dir, overwrite=overwrite)
                print_result(f"{len(recording.frames)} frames: {unpack_dir / MANIFEST_FILE}")
                return
            report = verify(predictor, recording, tolerances=tolerances, max_slowdown=max_slowdown)
        print_result(_table(report, predictor))
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


@dataclass(frozen=True)
class Comparison:
    """The answers to one frame, compared with the recorded ones.

    Attributes:
        name: of the frame.
        figures: head -> how far its answer is from the recorded one.
        faults: what differs by more than its limit, in words.
        predict_ms: time of the prediction now; None = there was none.
    """

    name: str
    figures: Figures
    faults: tuple[str, ...] = ()
    predict_ms: float | None = None


@dataclass(frozen=True)
class VerifyReport:
    """The comparison of a whole recording.

    Attributes:
        recording: that was compared.
        limits: head -> limits of its figures.
        checks: of the frames, in order.
        max_slowdown: limit of `slowdown`; infinity = times are not compared.
    """

    recording: Recording
    limits: Figures
    checks: tuple[Comparison, ...]
    max_slowdown: float

    @property
    def failed(self) -> list[Comparison]:
        """Frames whose answers differ."""
        return [check for check in self.checks if check.faults]

    @cached_property
    def slowdown(self) -> float | None:
        """The median time now over the recorded one; None where no times were recorded."""
        now_ms = [each.predict_ms for each in self.checks if each.predict_ms is not None]
        recorded = [each.predict_ms for each in self.recording.frames]
        recorded_ms = [each for each in recorded if each is not None]
        if not now_ms or not recorded_ms:
            return None
        return statistics.median(now_ms) / max(statistics.median(recorded_ms), 1e-9)

    @property
    def slow(self) -> bool:
        """Whether predictions take more than `max_slowdown` times what was recorded."""
        return (self.slowdown or 0) > self.max_slowdown

    @property
    def passed(self) -> bool:
        """Whether there are answers, and all are the recorded ones within `max_slowdown`."""
        return bool(self.checks) and not self.slow and not self.failed


def verify(
    predictor: Predictor,
    recording: Recording,
    *,
    tolerances: Mapping[str, float],
    max_slowdown: float = math.inf,
) -> VerifyReport:
    """Predict each recorded frame, and compare the answers with the recorded ones.

    Each new size of frame is predicted once before it is timed.

    Args:
        predictor: answers the frames.
        recording: frames and answers.
        tolerances: head -> limit of its first figure (share of equal pixels, largest or mean
            difference), in place of the recording's limits.
        max_slowdown: limit of the median time over the recorded one.

    Raises:
        InputError: if the arrays of the recording are damaged, if it lacks a head of `tolerances`,
            or times for `max_slowdown`.
    """
    if unknown := sorted(tolerances.keys() - recording.limits.keys()):
        raise InputError(
            f"--tolerance names {', '.join(unknown)}, the recording holds "
            f"{', '.join(recording.limits)}"
        )
    given = {head: {first_figure(head): value} for head, value in tolerances.items()}
    limits = {**recording.limits, **given}
    warm: set[tuple[int, ...]] = set()
    checks = tuple(
        _check_frame(predictor, frame, recording.arrays(index), limits, warm)
        for index, frame in enumerate(recording.frames)
    )
    report = VerifyReport(recording, limits, checks, max_slowdown)
    if max_slowdown < math.inf and report.slowdown is None:
        raise InputError(
            "--max-slowdown needs times, and this recording has none: record with ssdnet-run"
        )
    return report


def _check_frame(
    predictor: Predictor,
    frame: RecordedFrame,
    arrays: dict[str, NDArray[Any]],
    limits: Figures,
    warm: set[tuple[int, ...]],
) -> Comparison:
    """Predict a frame again. warm: shapes of pictures that were predicted before."""
    rgb, sparse_depth = arrays.pop("rgb"), arrays.pop("sparse_depth")
    try:
        if rgb.shape not in warm:
            predictor.predict(rgb, sparse_depth, focal_length_px=frame.focal_length_px)
            warm.add(rgb.shape)
        prediction = predictor.predict(rgb, sparse_depth, focal_length_px=frame.focal_length_px)
    except InferenceError as error:
        return Comparison(frame.name, {}, (str(error),))
    degraded = prediction.degraded if frame.degraded is None else frame.degraded
    pairs = {
        "valid": (str(prediction.valid), str(frame.valid)),
        "degraded": (", ".join(prediction.degraded), ", ".join(degraded)),
        "heads": (", ".join(sorted(prediction.heads)), ", ".join(sorted(limits))),
    }
    faults = [
        f"{name}: {now or 'none'}, expected {then or 'none'}"
        for name, (now, then) in pairs.items()
        if now != then
    ]
    figures: dict[str, dict[str, float]] = {}
    for head, expected in arrays.items():
        answer = prediction.heads.get(head)
        if answer is None:
            continue
        if answer.shape != expected.shape:
            faults.append(f"{head}: shape {answer.shape}, expected {expected.shape}")
            continue
        figures[head] = compare(head, answer, expected)
        if not within(figures[head], limits[head]):
            faults.append(f"{head}: {_text(figures[head])} (limit {_text(limits[head])})")
    return Comparison(frame.name, figures, tuple(faults), prediction.latency.total_ms)


def _text(figures: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.6g}" for name, value in figures.items())


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
        figures = [check.figures[head] for check in checks if head in check.figures]
        for name, limit in limits.items():
            most = f"{worst(figures)[name]:.6g}" if figures else "n/a"
            lines.append(f"{head:18}{name:14}{most:>12}{limit:>12.6g}")
    if report.slowdown is not None:
        lines.append(
            f"{'time':18}{'x recorded':14}{report.slowdown:>12.3f}{report.max_slowdown:>12g}"
        )
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
