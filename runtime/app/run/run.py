"""Running a model over a stream of frames, and writing the requested outputs."""

import contextlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from runtime.app.run import pipeline
from runtime.app.run.engine_facts import engine_facts, running_providers
from runtime.app.run.options import CLOUD, KINDS, SUFFIXES, RunOptions, saved_heads
from runtime.app.run.outages import Timeline, find_outages
from runtime.app.run.outputs.registry import open_outputs, require_outputs
from runtime.app.run.outputs.run_context import RunContext
from runtime.app.run.run_report import RUN_FILES, RunReport, group_reasons, size_text, write_report
from runtime.base.errors import InputError, SSDNetError
from runtime.checks.catalog import LENS_ENDS, NO_MATCH
from runtime.checks.finding import Finding, Severity
from runtime.checks.judge import FIRST_FRAMES, NO_RETURNS
from runtime.command.process import stop_requested
from runtime.engine.predictor import Predictor
from runtime.engine.preprocess import check_sparse_depth
from runtime.files.own_folder import locked_folder, make_own_folder
from runtime.geometry.lens import EQUIDISTANT, cache_key, rays
from runtime.recordings.images import is_in_metres
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
from runtime.streams.answerer import Answerer, known_focal_length_px
from runtime.streams.frame import Frame
from runtime.streams.frame_memory import FrameMemory
from runtime.streams.messages import Sensor
from runtime.streams.stream_checks import StreamChecks

_LEAST_UNSEEN = 0.02  # share of the pixels; the corners of a correct calibration may lie beyond it
_MOST_UNREADABLE = 20  # a stream is refused if none of these frames can be predicted

# Called before the first frame with a text about the run and the number of frames. Returns a
# function that is called with the result of each frame.
OnStart = Callable[[str, int], pipeline.OnRecord]


def run(
    options: RunOptions, *, on_start: OnStart = lambda about, frames: lambda record: None
) -> RunReport:
    """Predict every frame of a stream, and write the answers and a report.

    The cameras of a rig are streams that run one after the other, each with its own folder. Ctrl-C,
    SIGTERM and SIGHUP end the stream early; what was predicted is written and reported.

    Args:
        options: what to run, and what to write.
        on_start: called before the first frame with a text about the run and the number of frames;
            returns a function that is called with the result of each frame.

    Returns:
        The report, which is also written as report.json.

    Raises:
        SSDNetError: if the source, the model or an output cannot be opened, or if there is no
            space.
    """
    pipeline.dedicate_process()
    with contextlib.ExitStack() as stack:
        cameras = options.open_cameras()
        for source in cameras.values():
            stack.enter_context(source)
        if options.focal_length is not None and len(cameras) > 1:
            raise InputError(
                f"--focal-length describes one camera, but there are {len(cameras)}: leave it "
                "out, or run each camera by itself"
            )
        for camera, source in cameras.items():
            require_outputs(options.of_camera(camera), source)
        predictor = stack.enter_context(options.open_predictor())
        reports: dict[str, RunReport] = {}
        # Before the first frame a signal ends the process.
        stop: Callable[[], bool] = lambda: False  # noqa: E731
        for camera, source in cameras.items():
            if stop():
                break
            try:
                with source.collecting():
                    stream = _CameraStream(options, source, predictor)
                if not reports:
                    options = options.with_folder()
                    stack.enter_context(locked_folder(options.folder))
                    if camera:
                        make_own_folder(options.folder, RUN_FILES, overwrite=options.overwrite)
                    stop = stack.enter_context(stop_requested())
                reports[camera] = stream.answer(options.of_camera(camera), camera, on_start, stop)
            except InputError as error:
                if not camera:
                    raise
                raise InputError(f"{camera}: {error}") from error
        if "" in reports:
            return reports[""]
        is_whole = len(reports) == len(cameras)
        report = RunReport.of_rig(reports, options, interrupted=not is_whole)
        write_report(report)
        return report


class _CameraStream:
    """The stream of a camera: listed, warmed up, its first frames judged; nothing is written yet.

    Raises:
        InputError: if the stream or an option is refused, see `_answered_kinds` and `_warm_up`.
    """

    def __init__(self, options: RunOptions, source: Source, predictor: Predictor) -> None:
        if options.rectify:
            source.rectify_images()
        listed = source.list_frames(limit=options.limit)
        self._source, self._predictor = source, predictor
        self._frames, self._read = listed[options.part], pipeline.FrameReader(source)
        self._focal_px = focal_px = known_focal_length_px(predictor, source.calibration)
        self._kinds = _answered_kinds(options, predictor, focal_px)
        self._size = size = _warm_up(predictor, self._frames, self._read, runs=options.warmup)
        self._scale = predictor.camera_scale(size, focal_length_px=focal_px) if size else None
        has_scale = predictor.contract.canonical_focal_px is not None
        self._checks = StreamChecks(
            check_depth="depth" in predictor.heads,
            has_lidar=source.has_lidar(self._frames),
            accept=options.accepted,
            depth_scale=_depth_scale_of(source, listed),
            focal_px=focal_px if has_scale else None,
        )
        self._memory = FrameMemory.of(0.0 if options.shard else options.memory)
        self._answerer = Answerer(predictor, self._checks, memory=self._memory)
        # The first frames of the whole list are judged, so that all shards have the same findings.
        self._answerer.begin(_read_first_frames(listed, self._read))
        faults = _header_faults(source, listed, size)
        self._faults = [each for each in faults if each.name not in options.accepted]

    def _about(self) -> str:
        """The lines that are printed before the first frame: notes, model, sizes, range, faults."""
        predictor, scale, size = self._predictor, self._scale, self._size
        running = ", ".join(running_providers(predictor.providers, predictor.node_counts))
        network = predictor.network_size(size) if size else None
        lines = [
            *self._source.notes,
            f"{predictor.contract.model_name} sha256:{predictor.model.sha256[:12]} | {running} | "
            f"threads {predictor.threads} | frames {size_text(size)}, "
            f"network at {size_text(network)}",
        ]
        if scale is not None:
            used = f"{self._focal_px:g} px" if self._focal_px else "not known: give --focal-length"
            if scale.focal_length_px is None and self._focal_px is not None:
                used += ", not used by this model"
            lines.append(f"focal length {used}; depth up to {scale.range_m:.4g} m")
        if self._checks.judgement.frames:
            lines.append(f"calibration: {self._checks.judgement.text}")
        return "\n".join([*lines, *(each.line for each in self._findings)])

    @property
    def _findings(self) -> list[Finding]:
        """What was found so far."""
        return [*self._faults, *self._checks.findings]

    def answer(
        self, options: RunOptions, camera: str, on_start: OnStart, stop: Callable[[], bool]
    ) -> RunReport:
        """Answer the frames of a camera, and write what was requested."""
        names, sensors = [each.name for each in self._frames], self._source.sensor_frames
        context = RunContext(options, self._predictor, self._kinds, names, sensors)
        about = f"{camera}: {self._about()}" if camera else self._about()
        with open_outputs(context) as outputs:
            with self._source.collecting():
                on_record = on_start(about, len(names))
                stream = pipeline.StreamRun(
                    self._answerer, self._read, options, outputs, on_record, stop
                )
                result = stream.run(self._frames)
            context.report = self._report(context, result)
        return context.report

    def _report(self, run: RunContext, result: pipeline.StreamResult) -> RunReport:
        answers = [each.prediction for each in result.records if each.prediction]
        # The LiDAR may have started later.
        cleared = (NO_MATCH, NO_RETURNS) if any(each.depth_returns for each in answers) else ()
        options, source, scale = run.options, self._source, self._scale
        inputs = {
            "source": f"{options.source_path.kind}:{options.source_path.path}",
            **source.inputs,
            "focal_length_px": self._focal_px,
            "used_focal_length_px": scale and scale.focal_length_px,
            "depth_range_m": scale and round(scale.range_m, 2),
            "lens": source.calibration and source.calibration.lens,
            "distortion": source.calibration and source.calibration.distortion,
            "camera_frame": source.sensor_frames.camera,
            "frames_from": source.sensor_frames.origin or None,
            "assumptions": [note for note in source.notes if note.startswith("warning: ")],
            "rectified_by_this_run": options.rectify,
            "shard": options.shard,
            "memory_emptied": dict(self._memory.cleared) if self._memory else {},
            "warmup": options.warmup,
        }
        timeline = Timeline.of(result.records, source.stamps_ns)
        whole = options.limit is None and not result.interrupted
        outages = find_outages(result.records, source.stamps_ns, timeline, whole=whole)
        return RunReport(
            engine_facts(self._predictor),
            options,
            inputs,
            self._kinds,
            result,
            findings=tuple(each for each in self._findings if each.name not in cleared),
            judgements={"": self._checks.judgement},
            outages=outages,
            timeline=timeline,
            beyond_png=run.beyond_png,
        )


def _answered_kinds(
    options: RunOptions, predictor: Predictor, focal_px: float | None
) -> tuple[str, ...]:
    """The kinds of files that the model answers. Raises InputError if it lacks a requested one."""
    heads = {**{kind: head.name for kind, head in saved_heads().items()}, CLOUD: "depth"}
    missing = [kind for kind in options.kinds if heads.get(kind) not in (None, *predictor.heads)]
    are_all = set(KINDS) <= set(options.kinds)  # "all" stands for those that the model has
    if missing and (CLOUD in missing or not are_all):
        raise InputError(
            f"--save requests {', '.join(missing)}, but the model {predictor.contract.model_name} "
            f"answers {', '.join(predictor.heads)}: leave it out, or choose another --model"
        )
    if CLOUD in options.kinds and focal_px is None:
        raise InputError(
            "--save cloud needs the camera's intrinsics: give --calibration or --focal-length"
        )
    if options.max_uncertainty is not None and "depth_uncertainty" not in predictor.heads:
        raise InputError(
            f"--max-uncertainty needs the uncertainty of the depth, which the model "
            f"{predictor.contract.model_name} does not answer: leave it out, or choose another "
            "--model"
        )
    kinds = [kind for kind in options.kinds if kind not in missing]
    if are_all:  # also of heads that another package registers
        kinds += [k for k, head in heads.items() if k not in SUFFIXES and head in predictor.heads]
    return tuple(dict.fromkeys(kinds))


def _header_faults(
    source: Source, listed: Sequence[ListedFrame], size: tuple[int, int] | None
) -> Iterator[Finding]:
    """What calibration and stamps show without any prediction."""
    calibration = source.calibration
    lens = calibration.lens_model if calibration else None
    # A fisheye lens may see less than its images hold.
    if calibration and lens and lens.model != EQUIDISTANT and size:
        has_no_ray = np.isnan(rays(lens, cache_key(calibration.intrinsics), size)).any(axis=-1)
        if (unseen := float(has_no_ray.mean())) >= _LEAST_UNSEEN:
            text = (
                f"the lens of the calibration, {lens.model} {list(lens.coefficients)}, ends inside "
                f"the images: {unseen:.0%} of the pixels have no ray, and get no return. Check the "
                "coefficients and their order"
            )
            yield Finding(LENS_ENDS, text, Severity.WARNING)
    has_depth = any(reason.startswith(f"{Sensor.DEPTH}:") for reason in source.left_out)
    if has_depth and all(each.depth is None for each in listed):
        text = (
            "no image matches the time of a scan or depth map: check that both have time stamps of "
            "the same recording and clock, or give a larger --max-skew-ms"
        )
        yield Finding(NO_MATCH, text, Severity.FAULT)


def _read_first_frames(listed: Sequence[ListedFrame], read: pipeline.FrameReader) -> list[Frame]:
    """Return the first frames that have depth and can be read; they are kept for the run."""
    frames = []
    for each in listed[:FIRST_FRAMES]:
        with contextlib.suppress(SSDNetError):  # the run itself will report the error
            frame, _ = read(each, keep=True)
            check_sparse_depth(frame.sparse_depth, size=frame.size)
            if each.depth is not None:
                frames.append(frame)
    return frames


def _depth_scale_of(source: Source, listed: Sequence[ListedFrame]) -> float | None:
    """Return the units per metre of the first depth maps; None if they are in metres."""
    if source.depth_scale is not None:
        with contextlib.suppress(SSDNetError):  # the run itself will report the error
            first = [each.depth for each in listed[:FIRST_FRAMES] if each.depth is not None]
            if any(map(is_in_metres, first)):
                return None
    return source.depth_scale


def _warm_up(
    predictor: Predictor, frames: Sequence[ListedFrame], read: pipeline.FrameReader, *, runs: int
) -> tuple[int, int] | None:
    """Warm up at the size of the first frame that can be predicted, and return that size.

    The result is None if no frame of a short stream can be predicted; the run itself reports the
    reason. Raises InputError if none of the first _MOST_UNREADABLE frames can be predicted.
    """
    reasons = []
    for listed in frames[:_MOST_UNREADABLE]:
        try:
            frame, _ = read(listed, keep=True)
            check_sparse_depth(frame.sparse_depth, size=frame.size)
            predictor.warm_up(frame.size, runs=runs)
        except SSDNetError as error:
            reasons.append((listed.name, str(error)))
            continue
        return frame.size
    if len(reasons) == _MOST_UNREADABLE:
        raise InputError(
            f"none of the first {_MOST_UNREADABLE} frames can be predicted, nothing was written: "
            + "; ".join(group_reasons(reasons))
        )
    return None
