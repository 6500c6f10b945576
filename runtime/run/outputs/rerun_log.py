"""The answers of a run for the viewer Rerun (rerun.io; extra `rerun`)."""

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from runtime.errors import OutputError
from runtime.io.atomic_write import atomic_path
from runtime.io.encode import encode_jpeg
from runtime.prediction import Prediction
from runtime.predictor import Predictor
from runtime.run.options import RERUN_LIVE, is_rerun_file
from runtime.run.outputs.intrinsics import intrinsics_of
from runtime.run.outputs.output import OpenRun
from runtime.sources.frames import Frame

#: Entities, and the timelines they are logged on.
IMAGE, CLASSES, DEPTH = "camera/image", "camera/classes", "camera/depth"
CLOUD, LATENCY, HEALTH = "cloud", "latency", "health"
FRAME_TIME, SENSOR_TIME = "frame", "sensor"
_STAGES = ("preprocess_ms", "inference_ms", "postprocess_ms", "total_ms")
_PATIENCE_S = 20.0  # for a disk or a viewer to take what is logged
_FOOTER = b"RRF2FOOT"
_REMEDY = "free some space, choose another location, or check that the viewer is running"


class RerunLogger:
    """Log each frame; see `open_rerun`."""

    def __init__(self, log: Any, predictor: Predictor, target: str) -> None:
        import rerun

        contract = predictor.contract
        self._rerun, self._log, self._contract = rerun, log, contract
        self._focal_length_px, self._target = predictor.focal_length_px, target
        self._frames = 0
        classes = [(index, info.name, info.color) for index, info in enumerate(contract.classes)]
        log.log("/", rerun.AnnotationContext(classes), static=True)
        log.log(CLOUD, rerun.ViewCoordinates.RDF, static=True)  # x right, y down, z forward
        for stage in _STAGES:
            name = stage.removesuffix("_ms")
            log.log(f"{LATENCY}/{name}", rerun.SeriesLines(names=f"{name}, ms"), static=True)

    def write(self, frame: Frame, prediction: Prediction) -> None:
        """Log a frame and its answers; the cloud only where the camera is known.

        Raises OutputError.
        """
        rerun, log, contract = self._rerun, self._log, self._contract
        log.set_time(FRAME_TIME, sequence=self._frames)
        self._frames += 1
        if frame.image_stamp_ns is None:
            log.disable_timeline(SENSOR_TIME)
        else:  # of a clock with an unknown epoch
            log.set_time(SENSOR_TIME, duration=np.timedelta64(frame.image_stamp_ns, "ns"))
        picture = encode_jpeg(frame.rgb[..., ::-1])
        log.log(IMAGE, rerun.EncodedImage(contents=bytes(picture), media_type="image/jpeg"))
        if prediction.semantic is not None:
            log.log(CLASSES, rerun.SegmentationImage(prediction.semantic))
        if (depth := prediction.depth) is not None:
            if prediction.semantic is not None and contract.sky is not None:
                depth = np.where(prediction.semantic == contract.sky, np.float32(0), depth)
            reach = (0.0, contract.max_depth_m)
            log.log(DEPTH, rerun.DepthImage(depth, meter=1.0, depth_range=reach))
            if frame.calibration is not None or self._focal_length_px is not None:
                intrinsics = intrinsics_of(frame, self._focal_length_px)
                cloud = prediction.points(intrinsics, frame.rgb)
                points = rerun.Points3D(
                    cloud.points, colors=cloud.rgb, class_ids=cloud.semantic, radii=-1.5
                )
                log.log(CLOUD, points)
        for stage in _STAGES:
            time_ms = getattr(prediction.latency, stage)
            log.log(f"{LATENCY}/{stage.removesuffix('_ms')}", rerun.Scalars(time_ms))
        if prediction.degraded:
            text = f"{frame.name}: {', '.join(prediction.degraded)}"
            log.log(HEALTH, rerun.TextLog(text, level=rerun.TextLogLevel.WARN))
        try:
            log.flush(timeout_sec=_PATIENCE_S)  # what is queued takes memory
        except RuntimeError as error:
            raise OutputError(
                f"cannot log {frame.name} to {self._target} ({error}): {_REMEDY}"
            ) from error


@contextlib.contextmanager
def open_rerun(run: OpenRun) -> Iterator[RerunLogger]:
    """Log a run to --rerun: a viewer, or a file that gets its name when the block ends.

    The viewer on this machine (RERUN_LIVE) is started unless one is open.
    """
    import rerun

    target = run.options.rerun or RERUN_LIVE
    log = rerun.RecordingStream("ssdnet")
    with contextlib.ExitStack() as made:
        temporary = None
        try:
            if is_rerun_file(target):
                temporary = made.enter_context(
                    atomic_path(Path(target), overwrite=run.options.overwrite)
                )
                log.save(temporary, default_blueprint=_blueprint())
            elif target == RERUN_LIVE:
                with _scripts_on_path():
                    log.spawn(default_blueprint=_blueprint())
            else:
                log.connect_grpc(target, default_blueprint=_blueprint())
        except (RuntimeError, ValueError) as error:
            raise OutputError(f"cannot log to {target}: {error}") from error
        try:
            yield RerunLogger(log, run.predictor, target)
        finally:
            closed = _close(log)
        if not closed or (temporary is not None and not _is_whole(temporary)):
            raise OutputError(f"not all frames could be logged to {target}: {_REMEDY}")


@contextlib.contextmanager
def _scripts_on_path() -> Iterator[None]:
    """Put the viewer of this environment on PATH, also where the environment is not activated."""
    before = os.environ.get("PATH", os.defpath)
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), before])
    try:
        yield
    finally:
        os.environ["PATH"] = before


def _close(log: Any) -> bool:
    """Disconnect; returns whether everything was written or sent.

    With a full disk or a closed viewer the SDK would wait for ever, also at exit.
    """
    import rerun

    closing = threading.Thread(target=log.disconnect, daemon=True)
    closing.start()
    closing.join(_PATIENCE_S)
    if closing.is_alive():
        rerun.unregister_shutdown()
    return not closing.is_alive()


def _is_whole(path: Path) -> bool:
    """Whether a file has its footer: of a full disk the SDK only prints a message."""
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(file.tell() - len(_FOOTER) - 8, 0))
        return _FOOTER in file.read()


def _blueprint() -> Any:
    """The initial layout of the viewer: images on the left, cloud and times on the right."""
    import rerun.blueprint as views

    pictures = (
        views.Spatial2DView(origin="camera", contents=["/" + IMAGE], name="image"),
        views.Spatial2DView(origin="camera", contents=["/" + IMAGE, "/" + CLASSES], name="classes"),
        views.Spatial2DView(origin="camera", contents=["/" + DEPTH], name="depth"),
    )
    figures = (
        views.Spatial3DView(origin=CLOUD, name="cloud"),
        views.TimeSeriesView(origin=LATENCY, name="latency, ms"),
    )
    columns = (views.Vertical(*pictures), views.Vertical(*figures))
    return views.Blueprint(views.Horizontal(*columns), collapse_panels=True)
