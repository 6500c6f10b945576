"""Whether the depth of the first frames can be right, checked before a run."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from runtime.alignment.quick_check import QuickCheck
from runtime.app.run.pipeline import ReadFrame
from runtime.base.errors import SSDNetError
from runtime.engine.predictor import Predictor
from runtime.engine.preprocess import check_sparse_depth, clean_sparse_depth
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import EQUIDISTANT, cache_key, rays
from runtime.geometry.returns import is_measured
from runtime.recordings.images import is_in_metres
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
from runtime.streams.answerer import known_focal_length_px
from runtime.streams.health.calibration_size import CalibrationSize
from runtime.streams.health.depth_plausibility import FIRST_FRAMES, DepthPlausibility
from runtime.streams.messages import Sensor

_LEAST_UNSEEN = 0.02  # share of the pixels; the corners of a correct calibration may lie beyond it


@dataclass(frozen=True)
class DepthFault:
    """Why the depth of a stream cannot be right.

    Attributes:
        text: the fault and what to try.
        is_implausible: whether returns are wrong; False: the first frames have none, so later ones
            may clear it.
    """

    text: str
    is_implausible: bool = True


_NO_RETURNS = DepthFault(
    "no scan or depth map of the first frames has a return in the image: check that scans are "
    "in metres, and that the extrinsics of the calibration lead from the LiDAR to the camera",
    is_implausible=False,
)
_NO_MATCH = DepthFault(
    "no image matches the time of a scan or depth map: check that both have time stamps of the "
    "same recording and clock, or give a larger --max-skew-ms",
    is_implausible=False,
)


def find_lens_fault(calibration: Calibration | None, size: tuple[int, int] | None) -> str | None:
    """Return why a lens cannot belong to images of this (height, width), or None.

    A fisheye lens may see less than its images hold.
    """
    lens = calibration.lens_model if calibration else None
    if calibration is None or lens is None or lens.model == EQUIDISTANT or size is None:
        return None
    unseen = float(
        np.isnan(rays(lens, cache_key(calibration.intrinsics), size)).any(axis=-1).mean()
    )
    if unseen < _LEAST_UNSEEN:
        return None
    return (
        f"the lens of the calibration, {lens.model} {list(lens.coefficients)}, ends inside the "
        f"images: {unseen:.0%} of the pixels have no ray, and get no return. Check the "
        "coefficients and their order"
    )


def find_depth_fault(
    predictor: Predictor,
    frames: Sequence[ListedFrame],
    source: Source,
    read: ReadFrame,
    fit: QuickCheck,
) -> DepthFault | None:
    """Return why the depth of a stream cannot be right; None: nothing was found.

    This is done before the stream starts, since it needs predictions from the camera alone. `fit`
    gets these predictions, too.
    """
    has_depth = any(reason.startswith(f"{Sensor.DEPTH}:") for reason in source.left_out)
    if has_depth and all(each.depth is None for each in frames):
        return _NO_MATCH
    if "depth" not in predictor.heads:
        return None
    check, size_check = DepthPlausibility(), CalibrationSize()
    depth_scale = source.depth_scale
    returns: list[int] = []  # number of returns in each scan or depth map
    for listed in frames[:FIRST_FRAMES]:
        with contextlib.suppress(SSDNetError):  # the run itself will report the error
            frame, _ = read(listed, keep=True)
            check_sparse_depth(frame.sparse_depth, size=frame.size)
            if listed.depth is None:
                continue
            focal_px = known_focal_length_px(predictor, frame.calibration)
            range_m = predictor.camera_scale(frame.size, focal_length_px=focal_px).range_m
            returns.append(clean_sparse_depth(frame.sparse_depth, max_depth_m=range_m)[2])
            has_returns = bool(is_measured(frame.sparse_depth).any())
            camera_only = None
            if has_returns or frame.calibration is not None:
                camera_only = predictor.predict(frame.rgb, None, focal_length_px=focal_px)
                fit.add(frame, camera_only)
            if has_returns and camera_only is not None:
                check.add(camera_only, frame.sparse_depth)
                if depth_scale is not None and is_in_metres(listed.depth):
                    depth_scale = None
            size_check.add(
                camera_only if has_returns else None, frame.sparse_depth, frame.calibration
            )
    if (other_size := size_check.finding()) is not None:
        return DepthFault(other_size)
    if (finding := check.finding()) is not None:
        has_scale = predictor.contract.canonical_focal_px is not None
        focal_px = known_focal_length_px(predictor, source.calibration) if has_scale else None
        advice = finding.advice(depth_scale=depth_scale, focal_length_px=focal_px)
        mistake = fit.mistake() if finding.ratio is None else None
        return DepthFault(f"{advice}. Most likely: {mistake}" if mistake else advice)
    if returns and not any(returns):
        mistake = fit.mistake()
        nothing = "no scan of the first frames has a return in the image"
        return DepthFault(f"{nothing}: {mistake}") if mistake else _NO_RETURNS
    return None
