"""Run a model over a stream of frames, and write the requested outputs."""

import contextlib
import importlib.util
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from enum import StrEnum
from functools import partial
from pathlib import Path

from runtime.command import stop_requested
from runtime.drawing.overlay import SharedOverlay
from runtime.errors import InputError, OutputError, SSDNetError, install_command
from runtime.health.calibration_size import CalibrationSize
from runtime.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility
from runtime.io.engine_facts import engine_facts
from runtime.io.images import holds_metres
from runtime.io.recording import require_recordable
from runtime.prediction import IMPLAUSIBLE_DEPTH, Prediction
from runtime.predictor import Predictor
from runtime.preprocess import check_sparse_depth, clean_sparse_depth
from runtime.run.options import RunOptions
from runtime.run.outputs.output import OpenRun, Output, require_free
from runtime.run.outputs.registry import requested_outputs
from runtime.run.pipeline import FrameReader, StreamResult, WriteFrame, run_stream
from runtime.run.process import dedicate_process
from runtime.run.report_files import describe_predictor, group_reasons, write_report
from runtime.run.run_folder import CLOUD, KINDS, SAVED_HEADS, SUFFIXES, RunFolder
from runtime.run.run_report import RunReport
from runtime.sources.frames import Frame
from runtime.sources.source import ListedFrame, Source
from runtime.sync.frame_outcome import FrameOutcome
from runtime.sync.outcome import Sensor

_FIRST_FRAMES = 20  # a stream is refused if none of them can be predicted

OnRecord = Callable[[FrameOutcome], None]
#: Called before the first frame with a text about the run and the number of frames. Returns a
#: function that is called with the outcome of each frame.
OnStart = Callable[[str, int], OnRecord]


class _NoDepth(StrEnum):
    """Reason why the first frames have no depth ("no_depth"), although the source has depth."""

    NO_RETURNS = (
        "no scan or depth map of the first frames has a return in the image: check that scans are "
        "in metres, and that the extrinsics of the calibration lead from the LiDAR to the camera"
    )
    NO_MATCH = (
        "no image matches the time of a scan or depth map: check that both have time stamps of the "
        "same recording and clock, or give a larger --max-skew-ms"
    )


def run(
    options: RunOptions, *, on_start: OnStart = lambda about, frames: lambda record: None
) -> RunReport:
    """Predict every frame of a stream, and write the answers and a report.

    The cameras of a rig are streams one after the other, each with a folder of its own.
    Ctrl-C and SIGTERM end the stream early: what was predicted is written and reported.

    Args:
        options: what to run, and what to write.
        on_start: called before the first frame with a text about the run and the number of frames;
            returns a function that is called with the outcome of each frame.

    Returns:
        What was also written as report.json.

    Raises:
        SSDNetError: if the source, the model or an output cannot be opened, or there is no room.
    """
    dedicate_process()
    with contextlib.ExitStack() as opened:
        cameras = options.open_cameras()
        sources = [opened.enter_context(source) for source in cameras.values()]
        if len(sources) == 1:
            return _run_camera(options, sources[0], on_start)
        return _run_rig(options, cameras, on_start)


def _run_rig(options: RunOptions, cameras: Mapping[str, Source], on_start: OnStart) -> RunReport:
    """Run one camera after the other, each into a folder of its own, and write one report."""
    if options.focal_length is not None:
        raise InputError(
            f"--focal-length is of one camera, and there are {len(cameras)}: leave it out, or run "
            "each camera by itself"
        )
    for camera, source in cameras.items():
        _require_outputs(options.of_camera(camera), source)
    options.claim_folder()
    RunFolder(options.folder, kinds=(), overwrite=options.overwrite).close()
    reports: dict[str, RunReport] = {}
    with stop_requested() as stop:
        for camera, source in cameras.items():
            if reports and stop():
                break
            start = partial(_name_camera, camera, on_start)
            try:
                reports[camera] = _run_camera(
                    options.of_camera(camera), source, start, lambda: contextlib.nullcontext(stop)
                )
            except InputError as error:
                raise InputError(f"{camera}: {error}") from error
        is_whole = len(reports) == len(cameras)
        report = RunReport.of_rig(reports, options.folder, interrupted=not is_whole)
        write_report(report)
    return report


def _name_camera(camera: str, on_start: OnStart, about: str, frames: int) -> OnRecord:
    return on_start(f"{camera}: {about}", frames)


def _run_camera(
    options: RunOptions,
    source: Source,
    on_start: OnStart,
    stopping: Callable[[], AbstractContextManager[Callable[[], bool]]] = stop_requested,
) -> RunReport:
    if options.rectify:
        source.rectify_images()
    _require_apart(options.folder, source.folders)
    listed = source.list_frames(limit=options.limit)
    frames = options.shard_of(listed)
    reader = FrameReader(source.read)
    with _open_predictor(options, source) as predictor:
        kinds = _answered_kinds(options, predictor)
        frame_size = _warm_up(predictor, frames, reader, runs=options.warmup)
        _require_outputs(options, source)
        # The same for all shards.
        implausible = _unmatched(listed, source) or _implausible_depth(
            predictor, listed[:FIRST_FRAMES], reader, source
        )
        lines = [*source.notes, describe_predictor(predictor, frame_size)]
        about = "\n".join([*lines, f"warning: {implausible}"] if implausible else lines)
        contract, names = predictor.contract, [each.name for each in frames]
        overlay = SharedOverlay(contract.classes, contract.max_depth_m)
        options.claim_folder()
        opened = OpenRun(options, predictor, overlay, kinds, names)
        with stopping() as stop, _open_outputs(opened) as (write, record):
            result = run_stream(
                predictor,
                frames,
                reader=reader,
                rate_hz=options.rate,
                deadline_ms=options.deadline_ms,
                degraded=()
                if implausible is None or isinstance(implausible, _NoDepth)
                else (IMPLAUSIBLE_DEPTH,),
                write=write,
                record=record,
                on_record=on_start(about, len(frames)),
                stop=stop,
            )
            if implausible is _NoDepth.NO_RETURNS and any(
                done.prediction and done.prediction.depth_returns for done in result.records
            ):
                implausible = None  # the LiDAR started later
            report = _report(opened, source, frame_size, result, implausible)
            opened.report = report
        return report


def _open_predictor(options: RunOptions, source: Source) -> Predictor:
    return Predictor(
        options.model,
        sha256=options.sha256,
        provider=str(options.provider),
        size=options.network_size,
        focal_length_px=options.focal_length_px(source),
        threads=options.threads,
        warmup=0,
    )


def _answered_kinds(options: RunOptions, predictor: Predictor) -> tuple[str, ...]:
    """The kinds of files that the model answers. Raises InputError if one was requested by name."""
    heads = {**{kind: head for kind, (head, _) in SAVED_HEADS.items()}, CLOUD: "depth"}
    missing = [
        kind for kind in options.kinds if kind in heads and heads[kind] not in predictor.heads
    ]
    if missing and options.kinds is not KINDS:
        raise InputError(
            f"--save requests {', '.join(missing)}, but the model {predictor.contract.model_name} "
            f"answers {', '.join(predictor.heads)}: leave it out, or choose another --model"
        )
    if CLOUD in options.kinds and predictor.focal_length_px is None:
        raise InputError(
            "--save cloud needs the camera's intrinsics: give --calibration or --focal-length"
        )
    return tuple(kind for kind in options.kinds if kind not in missing)


def _warm_up(
    predictor: Predictor, frames: Sequence[ListedFrame], reader: FrameReader, *, runs: int
) -> tuple[int, int] | None:
    """Warm up at the size of the first frame that can be predicted; returns that size.

    None if no frame of a short stream can: the run itself reports why. Raises InputError if none of
    the first _FIRST_FRAMES can.
    """
    reasons = []
    for listed in frames[:_FIRST_FRAMES]:
        try:
            frame = reader.peek(listed)
            size = (frame.rgb.shape[0], frame.rgb.shape[1])
            check_sparse_depth(frame.sparse_depth, size=size)
            predictor.warm_up(size, runs=runs)
        except SSDNetError as error:
            reasons.append((listed.name, str(error)))
            continue
        return size
    if len(reasons) == _FIRST_FRAMES:
        raise InputError(
            f"none of the first {_FIRST_FRAMES} frames can be predicted, nothing was written: "
            + "; ".join(group_reasons(reasons))
        )
    return None


def _unmatched(frames: Sequence[ListedFrame], source: Source) -> str | None:
    """What is wrong if the source has depth and no frame has; None: nothing."""
    left_out = source.inputs.get("left_out") or {}
    has_depth = any(reason.startswith(f"{Sensor.DEPTH}:") for reason in left_out)
    return _NoDepth.NO_MATCH if has_depth and all(each.depth is None for each in frames) else None


def _implausible_depth(
    predictor: Predictor, frames: Sequence[ListedFrame], reader: FrameReader, source: Source
) -> str | None:
    """Why the returns of the first frames cannot be right, and what to try; None = nothing found.

    Done before the stream, since it takes predictions from the camera alone.
    """
    check, size_check = DepthPlausibility(), CalibrationSize()
    depth_scale = source.inputs.get("depth_scale")
    returns: list[int] = []  # of each scan or depth map
    for listed in frames if "depth" in predictor.heads else ():
        with contextlib.suppress(SSDNetError):  # the run itself reports it
            frame = reader.peek(listed)
            check_sparse_depth(frame.sparse_depth, size=(frame.rgb.shape[0], frame.rgb.shape[1]))
            if listed.depth is not None:
                scale = predictor.camera_scale((frame.rgb.shape[0], frame.rgb.shape[1]))
                returns.append(clean_sparse_depth(frame.sparse_depth, max_depth_m=scale.range_m)[2])
            if (frame.sparse_depth > 0).any():
                camera_only = predictor.predict(frame.rgb, None)
                check.add(camera_only, frame.sparse_depth)
                size_check.add(camera_only, frame.sparse_depth, frame.calibration)
                if depth_scale is not None and holds_metres(listed.depth):
                    depth_scale = None
            elif listed.depth is not None:
                size_check.add(None, frame.sparse_depth, frame.calibration)
    if (other_size := size_check.finding()) is not None:
        return other_size
    if (finding := check.finding()) is not None:
        has_scale = predictor.contract.canonical_focal_px is not None
        focal_px = predictor.focal_length_px if has_scale else None
        return finding.advice(depth_scale=depth_scale, focal_length_px=focal_px)
    return _NoDepth.NO_RETURNS if returns and not any(returns) else None


def _require_apart(out: Path, inputs: Sequence[Path]) -> None:
    """Raise OutputError if frames are read from where answers are written."""
    answers = {os.path.realpath(out / kind) for kind in SUFFIXES}
    for folder in inputs:
        if os.path.realpath(folder) in answers:
            raise OutputError(
                f"{folder} is where --out {out} writes its own pictures: choose another --out"
            )


def _require_outputs(options: RunOptions, source: Source) -> None:
    """Raise OutputError for an output that cannot be made, before anything is written."""
    for option, row in requested_outputs(options).items():
        if row.package is not None and importlib.util.find_spec(row.package) is None:
            raise OutputError(
                f"--{option} needs the package {row.package}, which is not installed: "
                f"{install_command(row.extra)}"
            )
    for path in options.named_files.values():
        require_free(path, overwrite=options.overwrite, inputs=source.recordings)
    if options.record is not None:
        require_recordable(options.record, overwrite=options.overwrite)


@contextlib.contextmanager
def _open_outputs(run: OpenRun) -> Iterator[tuple[WriteFrame | None, WriteFrame | None]]:
    """Open the requested outputs; yields `write` and `record` of `run_stream`."""

    def open_all(stack: contextlib.ExitStack, *, raw: bool) -> list[Output]:
        rows = [row for row in requested_outputs(run.options).values() if row.raw is raw]
        opened = [stack.enter_context(row.open(run)) for row in rows]
        return [output for output in opened if output is not None]

    # Recordings are opened first, and closed first.
    with contextlib.ExitStack() as others, contextlib.ExitStack() as recordings:
        recorders = open_all(recordings, raw=True)
        outputs = open_all(others, raw=False)
        yield _write_to(outputs), _write_to(recorders)


def _write_to(outputs: Sequence[Output]) -> WriteFrame | None:
    """Return a function that writes an answer to all outputs in order; None without outputs."""
    if not outputs:
        return None

    def write(frame: Frame, prediction: Prediction) -> None:
        for output in outputs:
            output.write(frame, prediction)

    return write


def _report(
    run: OpenRun,
    source: Source,
    frame_size: tuple[int, int] | None,
    result: StreamResult,
    implausible_depth: str | None,
) -> RunReport:
    options, predictor = run.options, run.predictor
    scale = predictor.camera_scale(frame_size) if frame_size else None
    inputs = {
        "source": f"{options.source_path.kind}:{options.source_path.path}",
        **source.inputs,
        "focal_length_px": predictor.focal_length_px,
        "used_focal_length_px": scale and scale.focal_length_px,
        "depth_range_m": scale and scale.range_m,
        "rectified": options.rectify,
        "shard": options.shard,
        "warmup": options.warmup,
    }
    return RunReport(
        engine_facts(predictor),
        inputs,
        options.folder,
        tuple(run.kinds),
        result,
        options.deadline_ms,
        implausible_depth,
    )
