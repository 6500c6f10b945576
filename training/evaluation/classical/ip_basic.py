"""IP-Basic: depth completion with morphology alone.

Ku, Harakeh and Waslander, "In Defense of Classical Image Processing: Fast Depth Completion on the
CPU", Conference on Computer and Robot Vision 2018. The kernels are those of the paper, chosen for
KITTI's 64 lines.

Depth is inverted first (100 m minus depth), so that near surfaces win over far ones in a dilation,
which is a local maximum. "Inverted" below means this depth; 0 in it is unknown.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from training.evaluation.classical.method import Depth

# Nearest and farthest measurement; nearer depths, and depths from the second on, are none. An
# inverted depth below the first is unknown (Ku et al.).
_MEASURED_M, _FARTHEST_M = 0.1, 100.0
# Ends of the ranges "near" and "medium" [m], which are dilated separately.
_NEAR_M, _MEDIUM_M = 15.0, 30.0
_BILATERAL_SIGMA_M, _BILATERAL_SIGMA_PX = 1.5, 2.0


@dataclass(frozen=True)
class IPBasic:
    """The fast variant, which gives the paper's result: about a dozen OpenCV filters.

    The steps are: dilation with a diamond, closing of small holes, filling of larger ones,
    continuation of every column up to the top of the image, filling of the largest holes, median,
    blur. Depth is filled within reach of the kernels (20 px from a return along rows and columns)
    and in the whole column above that; it is 0 elsewhere. The blur is Gaussian, for the lowest
    RMSE. The image is not used.
    """

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        measured = (sparse_depth > _MEASURED_M) & (sparse_depth < _FARTHEST_M)
        start = np.where(measured, np.float32(_FARTHEST_M) - sparse_depth, np.float32(0))
        if not start.any():
            return start
        filled = self._fill(start)
        smooth = _where_known(filled, self._blur(filled))
        depth = np.where(smooth > _MEASURED_M, np.float32(_FARTHEST_M) - smooth, np.float32(0))
        return depth.astype(np.float32)

    def _fill(self, start: Depth) -> MatLike:
        """Fill the unknown pixels of an inverted depth."""
        inverted = cv2.dilate(start, cv2.getStructuringElement(cv2.MORPH_DIAMOND, (5, 5)))
        inverted = cv2.morphologyEx(inverted, cv2.MORPH_CLOSE, _full(5))
        inverted = _fill_unknown(inverted, _full(7))
        inverted = _fill_unknown(_extend_to_top(inverted), _full(31))
        # As published, median and blur include the zeros of unknown pixels, so the depths of the
        # two outermost known pixels become too large.
        return cv2.medianBlur(inverted, 5)

    def _blur(self, inverted: MatLike) -> MatLike:
        return cv2.GaussianBlur(inverted, (5, 5), 0)


@dataclass(frozen=True)
class IPBasicMultiscale(IPBasic):
    """A slower variant that dilates each range of depths separately and removes noise.

    It follows the variant that the authors' code offers besides the paper's, with two differences:
    the bilateral blur has a sigma of 1.5 m of depth (0.5 m there), and a column without any depth
    stays empty.

    Near things, whose returns are far apart, are dilated with a larger cross than far ones, so that
    thin far things keep their width: 7 px up to 15 m, 5 px up to 30 m, 3 px beyond. The median that
    follows removes a return far from all others as noise; a frame with only such returns has no
    depth. Then holes are filled, step by step, by up to 16 px. Columns are continued to the top.
    The blur keeps edges.
    """

    def _fill(self, start: Depth) -> MatLike:
        inverted = cv2.morphologyEx(_dilate_by_range(start), cv2.MORPH_CLOSE, _full(5))
        inverted = _where_known(inverted, cv2.medianBlur(inverted, 5))

        below_top = np.maximum.accumulate(inverted > _MEASURED_M, axis=0)
        inverted = _fill_unknown(inverted, _full(9), within=below_top)
        inverted = _extend_to_top(inverted)
        below_top = np.maximum.accumulate(inverted > _MEASURED_M, axis=0)
        for _ in range(6):
            inverted = _fill_unknown(inverted, _full(5), within=below_top)
        return _where_known(inverted, cv2.medianBlur(inverted, 5))

    def _blur(self, inverted: MatLike) -> MatLike:
        return cv2.bilateralFilter(inverted, 5, _BILATERAL_SIGMA_M, _BILATERAL_SIGMA_PX)


def _dilate_by_range(inverted: Depth) -> MatLike:
    """Dilate far, medium and near depths separately; near ones replace medium and far ones."""
    depth = _FARTHEST_M - inverted
    combined: MatLike = np.zeros_like(inverted)
    for size, chosen in (
        (3, depth > _MEDIUM_M),
        (5, (depth > _NEAR_M) & (depth <= _MEDIUM_M)),
        (7, depth <= _NEAR_M),
    ):
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (size, size))
        dilated = cv2.dilate(np.where(chosen, inverted, np.float32(0)), cross)
        combined = np.where(dilated > _MEASURED_M, dilated, combined)
    return combined


def _full(size: int) -> NDArray[np.uint8]:
    return np.ones((size, size), dtype=np.uint8)


def _fill_unknown(
    inverted: MatLike, kernel: NDArray[np.uint8], *, within: NDArray[np.bool_] | bool = True
) -> MatLike:
    """Fill unknown pixels from a dilation; known pixels do not change."""
    unknown = (inverted <= _MEASURED_M) & within
    return np.where(unknown, cv2.dilate(inverted, kernel), inverted)


def _where_known(inverted: MatLike, changed: MatLike) -> MatLike:
    """Take the changed depths; unknown pixels stay unknown."""
    return np.where(inverted > _MEASURED_M, changed, inverted)


def _extend_to_top(inverted: MatLike) -> MatLike:
    """Continue every column upwards from its topmost value, because LiDAR sees nothing above it."""
    known = inverted > _MEASURED_M
    top = np.argmax(known, axis=0)  # 0 in a column without any value, where nothing is continued
    top_value = inverted[top, np.arange(inverted.shape[1])]
    above = np.arange(inverted.shape[0])[:, None] < top
    return np.where(above, top_value, inverted)
