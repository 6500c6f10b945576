"""What is found about the depth of a recording before its first frame is answered."""

import contextlib
from collections.abc import Sequence

import numpy as np

from runtime.app.run.pipeline import ReadFrame
from runtime.base.errors import SSDNetError
from runtime.checks.catalog import LENS_ENDS, NO_MATCH
from runtime.checks.finding import Finding, Severity
from runtime.checks.judge import FIRST_FRAMES
from runtime.engine.preprocess import check_sparse_depth
from runtime.geometry.calibration import Calibration
from runtime.geometry.lens import EQUIDISTANT, cache_key, rays
from runtime.recordings.images import is_in_metres
from runtime.recordings.listing import ListedFrame
from runtime.recordings.source import Source
from runtime.streams.frame import Frame
from runtime.streams.messages import Sensor

_LEAST_UNSEEN = 0.02  # share of the pixels; the corners of a correct calibration may lie beyond it


def find_header_faults(
    source: Source, listed: Sequence[ListedFrame], size: tuple[int, int] | None
) -> tuple[Finding, ...]:
    """Return what calibration and stamps show without any prediction."""
    faults = []
    if (text := _lens_fault(source.calibration, size)) is not None:
        faults.append(Finding(LENS_ENDS, text, Severity.WARNING))
    has_depth = any(reason.startswith(f"{Sensor.DEPTH}:") for reason in source.left_out)
    if has_depth and all(each.depth is None for each in listed):
        text = (
            "no image matches the time of a scan or depth map: check that both have time stamps of "
            "the same recording and clock, or give a larger --max-skew-ms"
        )
        faults.append(Finding(NO_MATCH, text, Severity.FAULT))
    return tuple(faults)


def read_first_frames(listed: Sequence[ListedFrame], read: ReadFrame) -> list[Frame]:
    """Return the first frames that have depth and can be read; they are kept for the run."""
    frames = []
    for each in listed[:FIRST_FRAMES]:
        with contextlib.suppress(SSDNetError):  # the run itself will report the error
            frame, _ = read(each, keep=True)
            check_sparse_depth(frame.sparse_depth, size=frame.size)
            if each.depth is not None:
                frames.append(frame)
    return frames


def depth_scale_of(source: Source, listed: Sequence[ListedFrame]) -> float | None:
    """Return the units per metre of the first depth maps; None if they are in metres."""
    if source.depth_scale is not None:
        with contextlib.suppress(SSDNetError):  # the run itself will report the error
            first = [each.depth for each in listed[:FIRST_FRAMES] if each.depth is not None]
            if any(map(is_in_metres, first)):
                return None
    return source.depth_scale


def _lens_fault(calibration: Calibration | None, size: tuple[int, int] | None) -> str | None:
    """Return why a lens cannot belong to images of this (height, width), or None.

    A fisheye lens may see less than its images hold.
    """
    lens = calibration.lens_model if calibration else None
    if calibration is None or lens is None or lens.model == EQUIDISTANT or size is None:
        return None
    has_no_ray = np.isnan(rays(lens, cache_key(calibration.intrinsics), size)).any(axis=-1)
    if (unseen := float(has_no_ray.mean())) < _LEAST_UNSEEN:
        return None
    return (
        f"the lens of the calibration, {lens.model} {list(lens.coefficients)}, ends inside the "
        f"images: {unseen:.0%} of the pixels have no ray, and get no return. Check the "
        "coefficients and their order"
    )
