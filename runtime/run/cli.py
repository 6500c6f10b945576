"""`ssdnet-run`: the command line of `runtime.run.run`."""

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from runtime.bundled_models import DEFAULT_MODEL, list_bundled_models
from runtime.command import ERROR, Provider, print_result, reported_errors
from runtime.command_options import NoDevice, Version
from runtime.contract import MAX_PIXELS
from runtime.io.encode import METRES_PNG_SCALE
from runtime.io.images import KITTI_DEPTH_SCALE
from runtime.io.model_table import describe_bundled_models
from runtime.io.scan import SCAN_SUFFIXES
from runtime.run.options import RunOptions, UsageError
from runtime.run.outputs.output import DEFAULT_RATE_HZ, FILE_SUFFIXES, RERUN_LIVE
from runtime.run.report_files import describe_run, list_results, report_json
from runtime.run.run import OnRecord, run
from runtime.run.run_folder import SUFFIXES
from runtime.sources.registry import SOURCES
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


def _print_models(wanted: bool) -> None:
    if wanted:
        with reported_errors("cpu"):
            print_result(describe_bundled_models())
        raise typer.Exit


@app.command(
    epilog="Exit codes: 0 done; 1 error; 2 usage; 3 finished, but frames were skipped, answers "
    "were invalid, or the run was stopped by Ctrl-C or SIGTERM; 4 a frame missed --deadline-ms, "
    "also if others were skipped; 130 stopped by Ctrl-C or SIGTERM before the first frame."
)
def main(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PATH]",
            help="Frames to predict: "
            + "; ".join(kind.accepted for kind in SOURCES.values())
            + ". Its kind follows from the path.",
        ),
    ] = None,
    rgb: Annotated[
        Path | None,
        typer.Option(
            help=f"Folder of the images (PNG or JPEG, at most {MAX_PIXELS // 10**6} megapixels)."
        ),
    ] = None,
    depth: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the sparse depth maps, or the one of one image: PNG, TIFF or .npy of "
            "16 bits (see --depth-scale), TIFF or .npy of floats in metres. "
            "[default: camera only]",
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            help="Folder of LiDAR scans, or the one of one image, in place of --depth: "
            f"{', '.join(SCAN_SUFFIXES)}. Needs --calibration.",
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:PATH",
            help=f"A path whose kind is named: {', '.join(SOURCES)}. --rgb DIR is folders:DIR. See "
            "docs/streams.md.",
        ),
    ] = None,
    demo: Annotated[bool, typer.Option("--demo", help="Run the bundled stream.")] = False,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|PATH",
            help=f"Name of a bundled model ({', '.join(list_bundled_models())}), or path of an "
            f"ONNX file made by ssdnet-export (ends in .onnx or contains a /). "
            f"[default: {DEFAULT_MODEL}]",
        ),
    ] = None,
    sha256: Annotated[
        str | None, typer.Option(help="Required SHA-256 of the model file. [default: any]")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results. [default: ssdnet-run, or ssdnet-run-2, ...]"),
    ] = None,
    provider: Annotated[Provider, typer.Option(help="Where the model runs.")] = Provider.cpu,
    size: Annotated[
        str,
        typer.Option(
            help="Size at which the network runs: auto (about the height it was trained for, if "
            "the frame is much larger), frame (size of the frame), ROWS, or HEIGHTxWIDTH. Results "
            "have the size of the frame."
        ),
    ] = "auto",
    focal_length: Annotated[
        float | None,
        typer.Option(
            help="Focal length of the camera (fx) in pixels of the images. A model with a "
            "canonical focal length then fits any camera; other models ignore it. "
            "[default: from the calibration of the source, else unknown]",
        ),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of inference. [default: physical cores]")
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option(
            help="Units per metre of 16-bit depth maps: KITTI 256, Virtual KITTI 100. "
            f"[default: {KITTI_DEPTH_SCALE:g}]"
        ),
    ] = None,
    point_columns: Annotated[
        int | None,
        typer.Option(
            min=3,
            help="float32 per point of .bin scans, x, y, z first. [default: 4, of .pcd.bin 5]",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of camera and LiDAR: a TOML file, or a file or folder of KITTI. "
            "[default: from the source]"
        ),
    ] = None,
    camera: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=3,
            help="Camera of kitti-raw (2 left, 3 right) or vkitti (0 left, 1 right). "
            "[default: left]",
        ),
    ] = None,
    image_topic: Annotated[
        str | None,
        typer.Option(help="Topic of the images in a bag. [default: the only one]"),
    ] = None,
    depth_topic: Annotated[
        str | None,
        typer.Option(
            help="Topic of the point clouds or depth images in a bag; none = camera only. "
            "[default: the only one]"
        ),
    ] = None,
    info_topic: Annotated[
        str | None,
        typer.Option(help="Topic of the CameraInfo. [default: the one beside the images]"),
    ] = None,
    max_skew_ms: Annotated[
        float | None,
        typer.Option(
            help="Largest difference of the stamps of an image and its depth, for sources with "
            f"stamps of both. [default: {DEFAULT_MAX_SKEW_MS:g}]"
        ),
    ] = None,
    deadline_ms: Annotated[
        float | None,
        typer.Option(
            help="Deadline of a prediction, without reading and writing; with --rate it counts "
            "from when the frame is due."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Frames per second: frames are due at fixed times as from a sensor "
            "(constant-stream), and age and jitter are reported. [default: each when the one "
            "before is done (single-stream)]"
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Stop after N complete frames.")] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Run part I of N of the stream, from 1/N to N/N: every N-th frame (of --limit "
            "frames if given). All parts together give the results of one run.",
        ),
    ] = None,
    warmup: Annotated[
        int, typer.Option(min=0, help="Predictions before the first frame, not in the statistics.")
    ] = 3,
    save: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND,...",
            help=f"Files to write of each frame: {', '.join(SUFFIXES)}; all = everything that the "
            "model answers, except clouds; or none. May be repeated. Depth and uncertainty are "
            f"16-bit PNGs, metres x {METRES_PNG_SCALE}. A cloud is a PLY file with colours and "
            "class ids, 16 bytes per pixel, and needs --calibration or --focal-length. "
            "[default: all]",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Record frames, results and model for ssdnet-verify; about 17 bytes per pixel and "
            "frame.",
        ),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['video']}",
            help=f"Write the overlays as a video, at --rate or {DEFAULT_RATE_HZ:g} Hz.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['report']}",
            help="Write an HTML page: latency over time, stages, health, sample images, and facts "
            "of the run.",
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['mcap']}",
            help="Write the results as standard ROS 2 messages (extra bag), with the stamps of the "
            "camera, or at --rate where there are none.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['rerun']}|{RERUN_LIVE}|URL",
            help="Log the run for the viewer Rerun (extra rerun): to a file, to the viewer on this "
            "machine, or to rerun+http://HOST:PORT/proxy. The cloud needs --calibration or "
            "--focal-length.",
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="Replace the files of an earlier run in --out, and existing files of the options "
            "above. Files of others are never replaced.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print report.json instead of the tables.")
    ] = False,
    _device: NoDevice = None,
    _list_models: Annotated[
        bool,
        typer.Option(
            "--list-models", callback=_print_models, is_eager=True, help="List the bundled models."
        ),
    ] = False,
    _version: Version = False,
) -> None:
    """Predict classes, depth and boundaries of every frame of a stream, and report the latency.

    Images and depth maps or scans in folders are paired by their stems, in natural order.
    """
    with reported_errors("cpu"), contextlib.ExitStack() as progress:
        try:
            options = RunOptions(
                path=path,
                rgb=rgb,
                depth=depth,
                points=points,
                source=source,
                demo=demo,
                model=model,
                sha256=sha256,
                out=out,
                provider=provider.value,
                size=size,
                focal_length=focal_length,
                threads=threads,
                depth_scale=depth_scale,
                point_columns=point_columns,
                calibration=calibration,
                camera=camera,
                image_topic=image_topic,
                depth_topic=depth_topic,
                info_topic=info_topic,
                max_skew_ms=max_skew_ms,
                deadline_ms=deadline_ms,
                rate=rate,
                limit=limit,
                shard=shard,
                warmup=warmup,
                save=save,
                record=record,
                video=video,
                report=report,
                mcap=mcap,
                rerun=rerun,
                overwrite=overwrite,
            )
        except UsageError as error:
            raise typer.BadParameter(str(error)) from error

        def start(about: str, frames: int) -> OnRecord:
            if not as_json:
                _print(about, options.folder)
            if not sys.stderr.isatty():
                return lambda record: None
            bar = typer.progressbar(length=frames, file=sys.stderr, label="frames")
            shown = progress.enter_context(bar)
            return lambda record: shown.update(1)

        done = run(options, on_start=start)
        progress.close()
        results = "\n".join([describe_run(done), *list_results(done, options)])
        printed = _print(report_json(done) if as_json else results, options.folder)
        raise typer.Exit(done.exit_code if printed or not as_json else ERROR)


def _print(text: str, out: Path) -> bool:
    """Print, or report why not. Returns whether it was printed."""
    return print_result(text, elsewhere=f": see {out}")
