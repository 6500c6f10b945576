"""A stream and its answers in the viewer Rerun (rerun.io).

    python examples/rerun_viewer.py [--rgb DIR --depth DIR --focal-length PX] [--out FILE.rrd]

Opens the viewer on this machine, or writes a file for it; needs the extra `rerun`. Entities:
`camera/image`, `camera/classes`, `camera/depth`, `cloud`, `latency/...` and `health`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as views

from runtime import (
    BUNDLED_FOCAL_LENGTH_PX,
    Frame,
    Prediction,
    Predictor,
    bundled_frames,
    open_source,
)

STAGES = ("preprocess_ms", "inference_ms", "postprocess_ms", "total_ms")


def main() -> None:
    """Log the stream once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rgb", type=Path)
    parser.add_argument("--depth", type=Path)
    parser.add_argument("--focal-length", type=float, help="fx in pixels of the images")
    parser.add_argument("--out", type=Path, metavar="FILE.rrd", help="default: the viewer")
    arguments = parser.parse_args()
    if (arguments.rgb is None) != (arguments.depth is None):
        parser.error("give both --rgb and --depth, or neither")
    focal_length_px = arguments.focal_length if arguments.rgb else BUNDLED_FOCAL_LENGTH_PX

    rerun.init("ssdnet")
    if arguments.out is None:
        rerun.spawn(default_blueprint=layout())
    else:
        rerun.save(arguments.out, default_blueprint=layout())
    with Predictor(focal_length_px=focal_length_px) as predictor:
        classes = predictor.contract.classes
        colours = [(index, info.name, info.color) for index, info in enumerate(classes)]
        rerun.log("/", rerun.AnnotationContext(colours), static=True)
        rerun.log("cloud", rerun.ViewCoordinates.RDF, static=True)  # x right, y down, z forward
        for number, frame in enumerate(read_frames(arguments.rgb, arguments.depth)):
            rerun.set_time("frame", sequence=number)
            prediction = predictor.predict(frame.rgb, frame.sparse_depth)
            log_answer(frame, prediction, predictor)
    rerun.disconnect()


def read_frames(rgb: Path | None, depth: Path | None) -> Iterator[Frame]:
    """Yield the frames of two folders, or of the bundled stream."""
    if rgb is None:
        yield from bundled_frames()
        return
    source = open_source("folders", rgb, depth=depth)
    for listed in source.list_frames():
        yield source.read(listed)


def log_answer(frame: Frame, prediction: Prediction, predictor: Predictor) -> None:
    """Log a frame and its answers; the cloud only where the focal length is known."""
    rerun.log("camera/image", rerun.Image(frame.rgb).compress(90))
    for stage in STAGES:
        time_ms = getattr(prediction.latency, stage)
        rerun.log(f"latency/{stage.removesuffix('_ms')}", rerun.Scalars(time_ms))
    if prediction.degraded:
        text = ", ".join(prediction.degraded)
        rerun.log("health", rerun.TextLog(text, level=rerun.TextLogLevel.WARN))
    if not prediction.valid or prediction.depth is None or prediction.semantic is None:
        return
    rerun.log("camera/classes", rerun.SegmentationImage(prediction.semantic))
    is_sky = prediction.semantic == predictor.contract.sky
    depth = np.where(is_sky, np.float32(0), prediction.depth)
    reach = (0.0, predictor.contract.max_depth_m)
    rerun.log("camera/depth", rerun.DepthImage(depth, meter=1.0, depth_range=reach))
    if (focal_px := predictor.focal_length_px) is not None:
        height, width = depth.shape
        middle = (width - 1) / 2, (height - 1) / 2
        intrinsics = np.array([[focal_px, 0, middle[0]], [0, focal_px, middle[1]], [0, 0, 1]])
        cloud = prediction.points(intrinsics, frame.rgb)
        points = rerun.Points3D(
            cloud.points, colors=cloud.rgb, class_ids=cloud.semantic, radii=-1.5
        )
        rerun.log("cloud", points)


def layout() -> views.Blueprint:
    """Return the layout of the viewer: images on the left, cloud and times on the right."""
    pictures = (
        views.Spatial2DView(origin="camera", contents=[f"/camera/{name}"], name=name)
        for name in ("image", "classes", "depth")
    )
    figures = (
        views.Spatial3DView(origin="cloud", name="cloud"),
        views.TimeSeriesView(origin="latency", name="latency, ms"),
    )
    columns = (views.Vertical(*pictures), views.Vertical(*figures))
    return views.Blueprint(views.Horizontal(*columns), collapse_panels=True)


if __name__ == "__main__":
    main()
