"""`ssdnet-calibrate`: whether a calibration is right, without a target; see `runtime.calibrate`."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from runtime.alignment.calibrate import CalibrationResult, Verdict, calibrate
from runtime.app.run.options import RunOptions
from runtime.app.tools.alignment_picture import draw_alignment
from runtime.base.errors import InputError
from runtime.command.options import GroupedCommand, Threads, read_options, with_options
from runtime.command.process import print_result, progress_bar, reported_errors, stop_requested
from runtime.drawing.encode import encode_jpeg, encode_png
from runtime.engine.predictor import Predictor
from runtime.files.atomic_write import atomic_write, require_writable
from runtime.geometry.calibration import Calibration
from runtime.geometry.poses import quaternion_of
from runtime.recordings.source import Source
from runtime.streams.frame_view import compensated_points

_NOT_VISIBLE, _WRONG = 3, 4  # exit codes
_EXIT_CODES = {Verdict.RIGHT: 0, Verdict.NOT_VISIBLE: _NOT_VISIBLE}
_PICTURES = (".jpg", ".jpeg", ".png")
# The options of `ssdnet-run` that state what is read.
_READ = ("path", "rgb", "points", "calibration", "rectify", "poses", "source", "max_skew_ms")

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(
    cls=GroupedCommand,
    epilog="Exit codes: 0 the calibration is right within the printed limits; 1 error; 2 usage; "
    "3 the frames do not show it; 4 it is off, or something else than its rotation is wrong; 130 "
    "stopped by Ctrl-C, SIGTERM or SIGHUP.",
)
@with_options(RunOptions, _READ)
def main(
    *,
    frames: Annotated[
        int,
        typer.Option(
            min=3, max=1000, help="Number of frames to look at, spread over the recording."
        ),
    ] = 20,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="Write the calibration to use to a file for --calibration. Nothing is written if "
            "the frames do not show it, or if something else than its rotation is wrong.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.jpg",
            help="Draw the returns on an image, by the given and by the refined calibration.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the files of --out and --picture.")
    ] = False,
    threads: Threads = None,
    **given: Any,
) -> None:
    """Check the rotation between LiDAR and camera in a recording, and refine it.

    The depth and boundaries that a bundled model predicts from the images alone are compared with
    the returns. The position of the LiDAR and the intrinsics are taken as they are.
    """
    with reported_errors("cpu"), stop_requested(interrupts=True):
        options = read_options(RunOptions, given)
        for option, path, suffixes in (("out", out, (".toml",)), ("picture", picture, _PICTURES)):
            if path is not None:
                if path.suffix.lower() not in suffixes:
                    raise typer.BadParameter(f"--{option} writes {suffixes[0]} files, got {path}")
                require_writable(path, overwrite=overwrite)
        with _open_source(options) as source, Predictor(threads=threads, warmup=0) as predictor:
            with progress_bar(frames, "frames") as advance:
                result = calibrate(source, predictor, frames=frames, on_frame=advance)
            notes, transform = source.notes, _transform(result, source)
        print_result("\n".join([*notes, *describe_result(result, transform)]))
        if out is not None and result.refined is not None:
            about = f"ssdnet-calibrate: {result.reason}"
            content = format_toml(result.refined, about, *transform).encode()
            atomic_write(out, content, overwrite=overwrite)
        if picture is not None:
            atomic_write(picture, _draw_picture(result, picture), overwrite=overwrite)
        raise typer.Exit(_EXIT_CODES.get(result.verdict, _WRONG))


def _open_source(options: RunOptions) -> Source:
    """Open the only camera. Raises InputError if there are several."""
    cameras = options.open_cameras()
    if len(cameras) > 1:
        for source in cameras.values():
            source.close()
        raise InputError(f"{len(cameras)} cameras are named: check each by itself")
    (source,) = cameras.values()
    if options.rectify:
        source.rectify_images()
    return source


def describe_result(result: CalibrationResult, transform: tuple[str, ...] = ()) -> list[str]:
    """The verdict, its evidence, and what else would look the same.

    `transform` holds lines with a command of ROS, which are printed if the calibration is off.
    """
    before, after = result.before, result.after
    lines = [
        f"calibration: {result.reason}",
        f"{len(result.frames)} frames, as good as {result.scenes:.1f} different scenes",
        f"boundary figure {before.edge:.3f} as given, {after.edge:.3f} at best; depth correlation "
        f"{before.depth_correlation:.3f}, {after.depth_correlation:.3f}",
    ]
    if result.verdict in (Verdict.RIGHT, Verdict.OFF):
        lines += [f"for the stated position and intrinsics: {each}" for each in result.alternatives]
    return lines + (list(transform) if result.verdict is Verdict.OFF else [])


def _transform(result: CalibrationResult, source: Source) -> tuple[str, ...]:
    """Lines with the command of ROS that publishes the refined calibration, if there is one."""
    if (refined := result.refined) is None:
        return ()
    camera, lidar, position = source.lidar_place
    if position is None:
        position = refined.extrinsics[:3, 3]
    return (format_static_transform(refined.extrinsics[:3, :3], position, (camera, lidar)),)


def _draw_picture(result: CalibrationResult, path: Path) -> bytes | memoryview:
    frame, calibrations = result.example, {"as given": result.given}
    if result.verdict is Verdict.OFF and result.refined is not None:
        calibrations["refined"] = result.refined
    points = compensated_points(frame)
    assert points is not None  # `calibrate` only takes frames with scans
    drawn = draw_alignment(frame.rgb, points, calibrations)
    return encode_png(drawn) if path.suffix.lower() == ".png" else encode_jpeg(drawn, quality=92)


def format_toml(calibration: Calibration, *comments: str) -> str:
    """Return the content of a file for --calibration, see `Calibration.from_toml`."""
    lines = [f"# {line}" for comment in comments for line in comment.splitlines()]
    for name in ("intrinsics", "extrinsics", "body_from_lidar"):
        if (matrix := getattr(calibration, name)) is not None:
            rows = ",\n".join(f"  {row}" for row in matrix.tolist())
            lines.append(f"{name} = [\n{rows},\n]")
    if calibration.size is not None:
        lines.append(f"size = {list(calibration.size)}")
    if calibration.lens is not None and calibration.distortion is not None:
        lines.append(f'lens = "{calibration.lens}"')
        lines.append(f"distortion = {[float(each) for each in calibration.distortion]}")
    return "\n".join(lines) + "\n"


def format_static_transform(
    rotation: NDArray[np.float64], position: NDArray[np.float64], frames: tuple[str, str]
) -> str:
    """Return the command of ROS 2 that publishes the LiDAR's place in the camera's frame.

    Args:
        rotation: float64 (3, 3), from the LiDAR's axes to the camera's.
        position: float64 (3,), position of the LiDAR in the camera's frame, metres.
        frames: names of the frames of camera and LiDAR.
    """
    values = zip(("x", "y", "z"), position, strict=True)
    turns = zip(("qw", "qx", "qy", "qz"), quaternion_of(rotation), strict=True)
    numbers = " ".join(f"--{name} {value:.9g}" for name, value in (*values, *turns))
    ids = "--frame-id {} --child-frame-id {}".format(*frames)
    return f"ros2 run tf2_ros static_transform_publisher {numbers} {ids}"
