"""`ssdnet-run`: a stream of frames in, pictures, tables and latencies out."""

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from runtime.bundled_models import DEFAULT_MODEL, list_bundled_models
from runtime.command import ERROR, Provider, reported_errors, say
from runtime.contract import MAX_PIXELS
from runtime.io.encode import METRES_PNG_SCALE
from runtime.io.images import KITTI_DEPTH_SCALE
from runtime.run.options import RunOptions, UsageError
from runtime.run.outputs.output import DEFAULT_RATE_HZ, FILE_SUFFIXES, RERUN_LIVE
from runtime.run.report_files import describe_run, list_results, report_json
from runtime.run.run import OnRecord, run
from runtime.run.run_folder import SUFFIXES
from runtime.sources.registry import SOURCES
from runtime.sync.stamp import DEFAULT_MAX_SKEW_MS

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    epilog="Exit codes: 0 done; 1 error; 2 usage; 3 finished, but frames were skipped or their "
    "answers not usable, or Ctrl-C or SIGTERM came; 4 --deadline-ms was missed by any frame, even "
    "if others were skipped; 130 Ctrl-C or SIGTERM came before the run began."
)
def main(
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
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for a recording of frames, answers and model, which ssdnet-verify holds "
            "later runs against; about 17 bytes a pixel and frame.",
        ),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['video']}",
            help=f"Write the overlays as a video, too; at --rate, or {DEFAULT_RATE_HZ:g} Hz.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['report']}",
            help="Write one page to look at: latency over time, stages, health, sample pictures "
            "and the facts of the run.",
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['mcap']}",
            help="Write the answers as ROS 2's standard messages, too (extra bag), with the "
            "stamps of the camera; where there are none, at --rate.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar=f"FILE{FILE_SUFFIXES['rerun']}|{RERUN_LIVE}|URL",
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
    with reported_errors("cpu"), contextlib.ExitStack() as progress:
        try:
            options = RunOptions(
                rgb=rgb,
                depth=depth,
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
                _say(about, out)
            if not sys.stderr.isatty():
                return lambda record: None
            bar = typer.progressbar(length=frames, file=sys.stderr, label="frames")
            shown = progress.enter_context(bar)
            return lambda record: shown.update(1)

        done = run(options, on_start=start)
        progress.close()
        results = "\n".join([describe_run(done), *list_results(done, options)])
        printed = _say(report_json(done) if as_json else results, out)
        raise typer.Exit(done.exit_code if printed or not as_json else ERROR)


def _say(text: str, out: Path) -> bool:
    """Print, or report why not: the results on disk matter more. Returns whether it was printed."""
    return say(text, otherwise=f": see {out}")
