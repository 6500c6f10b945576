"""`ssdnet-run`: a stream of frames in, pictures, tables and latencies out."""

import contextlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from runtime.bundled_models import DEFAULT_MODEL, list_bundled_models
from runtime.command import ERROR, Provider, reported_errors, say, stop_asked
from runtime.contract import MAX_FOCAL_PX, MAX_PIXELS, MIN_FOCAL_PX
from runtime.drawing.overlay import SharedOverlay
from runtime.drawing.report_page import PAGE_SUFFIX
from runtime.engine_facts import engine_facts
from runtime.errors import InputError, OutputError, SSDNetError
from runtime.io.encode import METRES_PNG_SCALE
from runtime.io.images import KITTI_DEPTH_SCALE
from runtime.io.recording import Settings
from runtime.predictor import Predictor
from runtime.run.options import (
    answered_kinds,
    parse_kinds,
    parse_shard,
    parse_size,
    parse_source,
    require_range,
    require_rerun_target,
    require_suffixes,
)
from runtime.run.outputs.frame_writer import FrameWriter
from runtime.run.outputs.mcap import MCAP_SUFFIX, open_mcap
from runtime.run.outputs.output import (
    DEFAULT_RATE_HZ,
    Output,
    require_free,
    require_package,
    write_to,
)
from runtime.run.outputs.recording_output import open_recording
from runtime.run.outputs.rerun_log import LIVE, RERUN_SUFFIX, is_file, open_rerun
from runtime.run.outputs.video import VIDEO_SUFFIX, open_video
from runtime.run.pipeline import OK, FrameRecord, Listed, StreamResult, run_stream
from runtime.run.process import dedicate_process
from runtime.run.run_folder import CLOUD, SUFFIXES
from runtime.run.run_report import build_report, describe_predictor, describe_run, to_json
from runtime.run.summary import exit_code, made_files, write_summary
from runtime.sources.bundled_stream import BUNDLED_FOCAL_LENGTH_PX, bundled_stream
from runtime.sources.frames import Frame
from runtime.sources.registry import SOURCES
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS

_WARM_UP_FRAMES = 16  # that are read to find one


app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    epilog="Exit codes: 0 done; 1 error; 2 usage; 3 finished, but frames were skipped or their "
    "answers not usable, or Ctrl-C or SIGTERM came; 4 --deadline-ms was missed by any frame, even "
    "if others were skipped; 130 Ctrl-C or SIGTERM came before the run began."
)
def run(
    rgb: Annotated[
        Path | None,
        typer.Option(
            help=f"Folder of the pictures (PNG or JPEG, at most {MAX_PIXELS // 10**6} megapixels)."
        ),
    ] = None,
    depth: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the sparse depth maps (16-bit PNG). [default: the camera alone]"
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:PATH",
            help=f"Where frames come from: {', '.join(SOURCES)}; --rgb DIR is folders:DIR. See "
            "docs/streams.md.",
        ),
    ] = None,
    demo: Annotated[bool, typer.Option("--demo", help="Run the bundled stream.")] = False,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|PATH",
            help=f"A bundled model ({', '.join(list_bundled_models())}), or an ONNX file made by "
            f"ssdnet-export: what ends in .onnx or holds a folder. [default: {DEFAULT_MODEL}]",
        ),
    ] = None,
    sha256: Annotated[
        str | None, typer.Option(help="SHA-256 that the model file must have. [default: any]")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("ssdnet-run"),
    provider: Annotated[Provider, typer.Option(help="What runs the model.")] = Provider.cpu,
    size: Annotated[
        str,
        typer.Option(
            help="Size at which the model runs: auto (about the height it was trained for, where "
            "the frame is much larger), frame (the frame's own), ROWS, or HEIGHTxWIDTH. Answers "
            "come at the frame's size."
        ),
    ] = "auto",
    focal_length: Annotated[
        float | None,
        typer.Option(
            help="Focal length of the camera (fx) in pixels of the pictures: a model that knows a "
            "canonical focal length then fits any camera; others do not heed it. "
            "[default: that of the source's calibration, else not known]",
        ),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(
            help="Units of the depth PNG a metre: KITTI 256, Virtual KITTI 100. "
            f"[default: {KITTI_DEPTH_SCALE:g}]"
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of camera and LiDAR: TOML, or KITTI's file or folder. "
            "[default: what the source holds]"
        ),
    ] = None,
    camera: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=3,
            help="Which camera of kitti-raw (2 left, 3 right) or vkitti (0 left, 1 right). "
            "[default: left]",
        ),
    ] = None,
    image_topic: Annotated[
        str | None,
        typer.Option(help="Topic of a bag's pictures. [default: the only one]"),
    ] = None,
    depth_topic: Annotated[
        str | None,
        typer.Option(
            help="Topic of a bag's point clouds or depth images; none: the camera alone. "
            "[default: the only one]"
        ),
    ] = None,
    info_topic: Annotated[
        str | None,
        typer.Option(help="Topic of the camera's CameraInfo. [default: the one beside the images]"),
    ] = None,
    max_skew_ms: Annotated[
        float | None,
        typer.Option(
            help="How far the stamps of an image and its depth may lie apart, where a source has "
            f"stamps of both. [default: {DEFAULT_MAX_SKEW_MS:g}]"
        ),
    ] = None,
    deadline_ms: Annotated[
        float | None,
        typer.Option(
            help="Time a prediction may take, without reading and writing; with --rate: from when "
            "the frame was due until its answer is there."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Frames a second, due at fixed times as from a sensor (constant-stream); age and "
            "jitter are then told. [default: each when the one before is done (single-stream)]"
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Stop after so many complete frames.")
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Run the I-th of N parts of the stream (1/N to N/N: every N-th frame, of --limit "
            "frames if that is given): all parts together answer what one run does.",
        ),
    ] = None,
    warmup: Annotated[
        int, typer.Option(min=0, help="Predictions before the first frame, kept apart.")
    ] = 3,
    save: Annotated[
        str,
        typer.Option(
            help=f"What to write: {', '.join(SUFFIXES)}; or all that the model answers but the "
            "cloud, or none. Depth and its uncertainty are 16-bit PNGs, metres x "
            f"{METRES_PNG_SCALE}; a cloud is a PLY file with colours and class ids, 16 bytes a "
            "pixel, and needs the camera: --calibration, or --focal-length."
        ),
    ] = "all",
    record_dir: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="DIR",
            help="Folder for a recording of frames, answers and model, which ssdnet-verify holds "
            "later runs against; about 17 bytes a pixel and frame.",
        ),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{VIDEO_SUFFIX}",
            help=f"Write the overlays as a video, too; at --rate, or {DEFAULT_RATE_HZ:g} Hz.",
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar=f"FILE{PAGE_SUFFIX}",
            help="Write one page to look at: latency over time, stages, health, sample pictures "
            "and the facts of the run.",
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{MCAP_SUFFIX}",
            help="Write the answers as ROS 2's standard messages, too (extra bag), with the "
            "stamps of the camera; where there are none, at --rate.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar=f"FILE{RERUN_SUFFIX}|{LIVE}|URL",
            help="Log the run for the viewer Rerun (extra rerun), too: to a file, to the viewer on "
            "this machine, or to one at an address rerun+http://HOST:PORT/proxy. The cloud needs "
            "the camera, as --save cloud does.",
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace the files of an earlier run in --out, no others, and the recording and "
            "other files that were asked for by name.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print report.json instead of the tables.")
    ] = False,
) -> None:
    """Predict classes, depth and boundaries of every frame of a stream, with the latency of each.

    Frames are pairs of files with the same stem, in natural order, or what another --source has.
    """
    kinds = parse_kinds(save)
    network_size = parse_size(size)
    part, parts = parse_shard(shard)
    require_range("--depth-scale", depth_scale, 1e-3, 1e6)
    require_range("--deadline-ms", deadline_ms, 1e-6, 1e9)
    require_range("--rate", rate, 1e-3, 1e6)
    require_range("--focal-length", focal_length, MIN_FOCAL_PX, MAX_FOCAL_PX)
    files = {
        "--video": (video, VIDEO_SUFFIX),
        "--report": (page, PAGE_SUFFIX),
        "--mcap": (mcap, MCAP_SUFFIX),
        "--rerun": (Path(rerun) if rerun and is_file(rerun) else None, RERUN_SUFFIX),
    }
    require_suffixes(files)
    if rerun is not None:
        require_rerun_target(rerun)
    require_range("--max-skew-ms", max_skew_ms, 0, 1e6)
    if demo + (rgb is not None) + (source is not None) != 1 or (demo and depth is not None):
        raise typer.BadParameter("give one of --demo, --rgb (with --depth) and --source")
    if demo and focal_length is None:
        focal_length = BUNDLED_FOCAL_LENGTH_PX
    with reported_errors("cpu"):
        if demo:
            rgb, depth = bundled_stream()
    source = source or f"folders:{rgb}"
    open_source = parse_source(
        source,
        depth=depth,
        depth_scale=depth_scale,
        calibration=calibration,
        camera=camera,
        image_topic=image_topic,
        depth_topic=depth_topic,
        info_topic=info_topic,
        max_skew_ms=max_skew_ms,
    )
    dedicate_process()
    with reported_errors("cpu"), open_source() as origin:
        _require_apart(out, *origin.folders)
        frames = origin.list_frames(limit=limit)[part - 1 :: parts]
        if focal_length is None and origin.calibration is not None:
            focal_length = origin.calibration.focal_length_px
        with Predictor(
            model,
            sha256=sha256,
            provider=provider.value,
            size=network_size,
            focal_length_px=focal_length,
            threads=threads,
            warmup=0,
        ) as predictor:
            kinds = answered_kinds(kinds, predictor, everything=save == "all")
            if CLOUD in kinds and focal_length is None:
                raise InputError(
                    "--save cloud needs to know the camera: give --calibration, or --focal-length"
                )
            frame_size = _warm_up(predictor, frames, origin.read, runs=warmup)
            if rerun is not None:
                require_package("--rerun", "rerun", extra="rerun")
            for path, _ in files.values():
                if path is not None:
                    require_free(path, overwrite=overwrite, inputs=origin.recordings)
            with stop_asked() as stop:  # only now: until here nothing was written
                overlay = SharedOverlay(predictor.contract.classes, predictor.contract.max_depth_m)
                settings = Settings("ssdnet-run", network_size, focal_length, provider.value)
                with contextlib.ExitStack() as whole:  # has its name when all frames are in it
                    keep = whole.enter_context(
                        open_recording(record_dir, settings, predictor, overwrite=overwrite)
                    )
                    writer = FrameWriter(
                        out,
                        predictor.contract,
                        kinds=kinds,
                        names=[listed.name for listed in frames],
                        overwrite=overwrite,
                        focal_length_px=focal_length,
                        overlay=overlay,
                    )
                    if not as_json:
                        about = [*origin.notes, describe_predictor(predictor, frame_size)]
                        _say("\n".join(about), out)
                    outputs: list[Output] = [writer] if kinds else []
                    if page is not None:
                        from runtime.run.outputs.run_page import RunPage

                        run_page = RunPage(predictor.contract)
                        outputs.append(run_page)
                    if video is not None:
                        opened = open_video(video, overlay, rate_hz=rate)
                        outputs.append(whole.enter_context(opened))
                    if mcap is not None:
                        bag = open_mcap(mcap, predictor.contract, overlay, rate_hz=rate)
                        outputs.append(whole.enter_context(bag))
                    if rerun is not None:
                        logger = open_rerun(rerun, predictor.contract, focal_length_px=focal_length)
                        outputs.append(whole.enter_context(logger))
                    result = _run(
                        predictor,
                        frames,
                        read=origin.read,
                        rate_hz=rate,
                        write=write_to(outputs),
                        keep=keep,
                        stop=stop,
                    )
                report = build_report(
                    predictor,
                    result,
                    inputs={
                        "source": source,
                        **origin.inputs,
                        "focal_length_px": focal_length,
                        "shard": shard,
                        "warmup": warmup,
                    },
                    output=str(out),
                    kinds=kinds,
                    deadline_ms=deadline_ms,
                )
                write_summary(out, result, report, deadline_ms)
                if page is not None:
                    run_page.finish(page, result, report, engine_facts(predictor))
                if as_json:
                    printed = _say(to_json(report).rstrip("\n"), out)
                    raise typer.Exit(exit_code(result, deadline_ms) if printed else ERROR)
                lines = [describe_run(result, report), f"results: {out.resolve()}"]
                if record_dir is not None:
                    lines.append(f"recording: {record_dir.resolve()}")
                lines += made_files(files)
                if "overlay" in kinds and any(record.status == OK for record in result.records):
                    lines.append(f"pictures: {(out / 'overlay').resolve()}")
                _say("\n".join(lines), out)
                raise typer.Exit(exit_code(result, deadline_ms))


def _say(text: str, out: Path) -> bool:
    """Print, or say why not: the results on disk matter more. Returns whether it was printed."""
    return say(text, otherwise=f": see {out}")


def _require_apart(out: Path, *inputs: Path) -> None:
    """Raise OutputError if frames are read from where answers are written."""
    answers = {(out / kind).resolve() for kind in SUFFIXES}
    for folder in inputs:
        if folder.resolve() in answers:
            raise OutputError(
                f"{folder} is where --out {out} writes its own pictures: choose another --out"
            )


def _warm_up(
    predictor: Predictor,
    frames: Sequence[Listed],
    read: Callable[[Listed], Frame],
    *,
    runs: int,
) -> tuple[int, int] | None:
    """Warm up at the size of the first frame that can be predicted, and give back its size; None
    if none of the first few can: the run itself will say why.
    """
    for listed in frames[:_WARM_UP_FRAMES]:
        try:
            frame = read(listed)
            height, width = frame.rgb.shape[:2]
            predictor.warm_up((height, width), runs=runs)
        except SSDNetError:
            continue
        return height, width
    return None


def _run(predictor: Predictor, frames: Sequence[Listed], **options: Any) -> StreamResult:
    """Run the stream, under a progress bar where stderr is a terminal."""
    if not sys.stderr.isatty():
        return run_stream(predictor, frames, **options)
    with typer.progressbar(length=len(frames), file=sys.stderr, label="frames") as bar:

        def advance(record: FrameRecord) -> None:
            bar.update(1)

        return run_stream(predictor, frames, on_record=advance, **options)
