"""Run a model over a stream of frames, and write the requested outputs."""

import contextlib
from collections.abc import Callable, Mapping, Sequence

from runtime.command import stop_requested
from runtime.drawing.overlay import Overlay
from runtime.errors import InputError, SSDNetError
from runtime.predictor import Predictor
from runtime.preprocess import check_sparse_depth
from runtime.run.depth_check import NoDepth, find_depth_fault, find_lens_fault
from runtime.run.engine_facts import engine_facts
from runtime.run.options import RunOptions
from runtime.run.outputs.output import OpenRun
from runtime.run.outputs.registry import open_outputs, require_outputs
from runtime.run.pipeline import FrameReader, StreamResult, run_stream
from runtime.run.process import dedicate_process
from runtime.run.run_folder import CLOUD, KINDS, SAVED_HEADS, make_run_folder
from runtime.run.run_report import RunReport, describe_predictor, group_reasons, write_report
from runtime.sources.source import ListedFrame, Source
from runtime.streams.answerer import Answerer
from runtime.streams.frame_result import FrameResult

_FIRST_FRAMES = 20  # a stream is refused if none of them can be predicted

OnRecord = Callable[[FrameResult], None]
#: Called before the first frame with a text about the run and the number of frames. Returns a
#: function that is called with the result of each frame.
OnStart = Callable[[str, int], OnRecord]


def run(
    options: RunOptions, *, on_start: OnStart = lambda about, frames: lambda record: None
) -> RunReport:
    """Predict every frame of a stream, and write the answers and a report.

    The cameras of a rig are streams one after the other, each with a folder of its own.
    Ctrl-C and SIGTERM end the stream early: what was predicted is written and reported.

    Args:
        options: what to run, and what to write.
        on_start: called before the first frame with a text about the run and the number of frames;
            returns a function that is called with the result of each frame.

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
        require_outputs(options.of_camera(camera), source)
    options = options.with_folder()
    make_run_folder(options.folder, kinds=(), overwrite=options.overwrite)
    reports: dict[str, RunReport] = {}
    with stop_requested() as stop:
        for camera, source in cameras.items():
            if reports and stop():
                break

            def start(about: str, frames: int, camera: str = camera) -> OnRecord:
                return on_start(f"{camera}: {about}", frames)

            try:
                reports[camera] = _run_camera(options.of_camera(camera), source, start, stop)
            except InputError as error:
                raise InputError(f"{camera}: {error}") from error
        is_whole = len(reports) == len(cameras)
        report = RunReport.of_rig(reports, options.folder, interrupted=not is_whole)
        write_report(report)
    return report


def _run_camera(
    options: RunOptions, source: Source, on_start: OnStart, stop: Callable[[], bool] | None = None
) -> RunReport:
    if options.rectify:
        source.rectify_images()
    listed = source.list_frames(limit=options.limit)
    frames = options.shard_of(listed)
    with Predictor(
        options.model,
        sha256=options.sha256,
        provider=str(options.provider),
        size=options.network_size,
        focal_length_px=options.focal_length_px(source),
        threads=options.threads,
        warmup=0,
    ) as predictor:
        kinds = _answered_kinds(options, predictor)
        reader = FrameReader(source)
        frame_size = _warm_up(predictor, frames, reader, runs=options.warmup)
        require_outputs(options, source)
        # Of the first frames of all shards, which so have the same finding.
        fault = find_depth_fault(predictor, listed, source, reader, options)
        about = [*source.notes, describe_predictor(predictor, frame_size)]
        faults = (find_lens_fault(source.calibration, frame_size), fault)
        about += [f"warning: {each}" for each in faults if each]
        overlay = Overlay(predictor.contract.classes, predictor.contract.max_depth_m)
        options = options.with_folder()
        opened = OpenRun(options, predictor, overlay, kinds, [each.name for each in frames])
        with (
            contextlib.nullcontext(stop) if stop else stop_requested() as stopped,
            open_outputs(opened) as (outputs, recorders),
        ):
            answerer = Answerer(
                predictor,
                focal_length_px=options.focal_length_px,
                check_depth=False,
                is_implausible=fault is not None and not isinstance(fault, NoDepth),
            )
            result = run_stream(
                answerer,
                frames,
                reader,
                rate_hz=options.rate,
                deadline_ms=options.deadline_ms,
                outputs=outputs,
                recorders=recorders,
                on_record=on_start("\n".join(about), len(frames)),
                stop=stopped,
            )
            answers = [each.prediction for each in result.records if each.prediction]
            if fault is NoDepth.NO_RETURNS and any(answer.depth_returns for answer in answers):
                fault = None  # the LiDAR started later
            opened.report = _report(opened, source, frame_size, result, fault)
        return opened.report


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
            frame = reader.read_first(listed)
            check_sparse_depth(frame.sparse_depth, size=frame.size)
            predictor.warm_up(frame.size, runs=runs)
        except SSDNetError as error:
            reasons.append((listed.name, str(error)))
            continue
        return frame.size
    if len(reasons) == _FIRST_FRAMES:
        raise InputError(
            f"none of the first {_FIRST_FRAMES} frames can be predicted, nothing was written: "
            + "; ".join(group_reasons(reasons))
        )
    return None


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
        "depth_range_m": scale and round(scale.range_m, 2),
        "lens": source.calibration and source.calibration.lens,
        "distortion": source.calibration and source.calibration.distortion,
        "assumptions": [note for note in source.notes if note.startswith("warning: ")],
        "rectified_by_this_run": options.rectify,
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
