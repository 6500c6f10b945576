"""Whether the returns can be depths, in metres, of the scene in the image.

The check finds a wrong unit, inverse depth, mirrored maps, and returns that fit the image nowhere.

The returns of some frames are compared with the depth that the model predicts from the image alone.
The logarithms of both correlate if the returns show the same scene, also in a wrong unit; the ratio
of both finds the wrong unit. Before correlating, the mean of each band of rows is subtracted:
otherwise "near below, far above" alone would correlate, even in a dark image. Limits and measured
values: docs/streams.md.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.checks.log_depth import BANDS, correlations, log_depth, subtract_band_means
from runtime.contract.degraded import IMAGE_CONSTANT
from runtime.engine.prediction import Prediction
from runtime.geometry.returns import is_measured

FIRST_FRAMES = 5  # frames checked when a stream starts; later the median of the last 5 counts
_LEAST_RETURNS, _MOST_RETURNS = 200, 50_000  # denser maps are subsampled
_ALIKE = 0.5  # least correlation of two depth maps of the same scene
# Correlations of depth maps of different scenes are below these, as they are and without the mean
# of each band of rows, in at least _KNOWN frames. Correct returns have medians of at least 0.5 and
# 0.28, even with dark, blurred or noisy images; swapped bytes and shuffled returns have 0.1 or
# less. Within a band both maps must spread by _LEAST_SPREAD: by night the model guesses a road with
# less (0.02 to 0.1).
_UNALIKE, _UNALIKE_IN_BANDS, _KNOWN, _LEAST_SPREAD = 0.3, 0.2, 3, 0.15
_MIRRORED_MARGIN = 0.2  # the mirrored map must correlate better by this much
# Return / camera-only depth: 0.67 to 1.15 for correct frames, 0.60 to 1.15 without a focal length,
# up to 1.7 (medians of five frames) in dark or blurred images.
_NEAREST, _FARTHEST = 0.35, 2.0
_FOCAL_RATIO = 10  # a wrong focal length explains at most this ratio
_DEPTH_SCALES = (1, 100, 256, 1000)  # for metres, centimetres, KITTI's units and millimetres


class Implausible(NamedTuple):
    """What is wrong with the returns of a stream."""

    cause: str
    ratio: float | None = None  # return / camera-only depth, if only the scale is wrong

    def advice(self, *, depth_scale: float | None, focal_length_px: float | None) -> str:
        """Return the cause, and what to try.

        Args:
            depth_scale: units per metre with which the returns were read; None if they were metres.
            focal_length_px: focal length that the model used; None if it used none, so that the
                focal length is not the cause.
        """
        if self.ratio is None:
            return self.cause
        what = "check their unit"
        if depth_scale is not None:
            wanted = depth_scale * self.ratio
            usual = min(_DEPTH_SCALES, key=lambda each: abs(math.log(each / wanted)))
            right = f"={usual}" if 0.5 < usual / wanted < 2 else f" of about {_rounded(wanted)}"
            what = f"try depth_scale{right} in --source"
        if focal_length_px is not None and 1 / _FOCAL_RATIO < self.ratio < _FOCAL_RATIO:
            fits = _rounded(focal_length_px * self.ratio)
            what += f", or check the focal length of {focal_length_px:g} px: about {fits} would fit"
        return f"{self.cause}: {what}"


class _Figures(NamedTuple):
    """Log of return / camera-only depth, correlations, and the smaller spread within a band."""

    log_ratio: float
    overall: float
    alike: float
    mirrored: float
    spread: float


class DepthPlausibility:
    """Compares the returns of a stream's frames with the camera-only prediction.

    The last FIRST_FRAMES frames count, so that a unit that changes is found, and an early alarm is
    cleared.
    """

    def __init__(self) -> None:
        self._figures: deque[_Figures] = deque(maxlen=FIRST_FRAMES)

    def add(self, camera_only: Prediction, sparse_depth: NDArray[np.float32]) -> None:
        """Add a frame; it is ignored if it has few returns or no camera-only depth.

        Args:
            camera_only: prediction from the image of the frame without any return.
            sparse_depth: float32 (H, W), metres, also beyond the range of the model.
        """
        depth = camera_only.depth
        row, column = np.nonzero(is_measured(sparse_depth))
        trusted = camera_only.valid and IMAGE_CONSTANT not in camera_only.degraded
        if depth is None or not trusted or len(row) < _LEAST_RETURNS:
            return
        step = len(row) // _MOST_RETURNS + 1
        row, column = row[::step], column[::step]
        views = sparse_depth, depth, depth[:, ::-1]
        measured, seen, mirrored = (log_depth(view[row, column]) for view in views)
        band = row * BANDS // len(depth)
        overall, alike = correlations(band, measured, seen)
        _, alike_mirrored = correlations(band, measured, mirrored)
        spread = float(min(subtract_band_means(band, each).std() for each in (measured, seen)))
        log_ratio = float(np.median(measured - seen))
        self._figures.append(_Figures(log_ratio, overall, alike, alike_mirrored, spread))

    def finding(self) -> Implausible | None:
        """Return the fault of the last frames; None if there is none, or none that is certain."""
        if not self._figures:
            return None
        log_ratio, overall, alike, mirrored, spread = np.median(self._figures, axis=0)
        if max(overall, alike) <= -_ALIKE:
            return Implausible(
                "the returns are far where the depth predicted from the image is near: they may be "
                "inverse depth or disparity"
            )
        if mirrored >= max(_ALIKE, alike + _MIRRORED_MARGIN):
            return Implausible(
                "the returns fit the mirrored image: the image or the depth is flipped left to "
                "right"
            )
        is_unalike = overall < _UNALIKE and alike < _ALIKE
        is_unalike |= alike < _UNALIKE_IN_BANDS and len(self._figures) >= _KNOWN
        if is_unalike and spread >= _LEAST_SPREAD:
            return Implausible(
                "the returns fit the image nowhere: their log depth and the one predicted from the "
                f"image correlate by {overall:.2f}, and by {alike:.2f} without the mean of each "
                f"row; right returns by more than {_UNALIKE:g} and {_UNALIKE_IN_BANDS:g}. Check "
                "that the extrinsics lead from the LiDAR to the camera, that image and depth are "
                "of the same moment, and the byte order of 16-bit depth maps"
            )
        ratio = float(np.exp(log_ratio))
        if min(overall, alike) >= _ALIKE and not _NEAREST <= ratio <= _FARTHEST:
            return Implausible(
                f"the returns are {_rounded(ratio)} times as far as the depth predicted from the "
                "image",
                ratio,
            )
        return None


def _rounded(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
