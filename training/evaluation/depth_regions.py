"""Depth errors by region: by distance to the nearest return, and by depth edges.

`RETURN_DISTANCES` are regions of every frame. The others need dense ground truth, such as that of
rendered scenes:

- A depth edge is a pixel for which the farthest true depth in the 3 x 3 pixels around it is more
  than `EDGE_RATIO` times the nearest. Pixels of unknown depth (sky), and those that are not scored,
  make no edge.
- "interior" is at most `RETURN_REACH_PX` from a return that was fed, and farther than
  `EDGE_REACH_PX` from every depth edge.
- "edge" is as near to a return, and at most `EDGE_REACH_PX` from a depth edge.
- "uncovered" is the rest, where only the image can help.

Distances are Euclidean between the centres of pixels, at the size of the frame.
"""

import math
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from training.evaluation.metrics import Accumulator, DepthErrors, ErrorSums, scored

RETURN_REACH_PX = 12
EDGE_REACH_PX = 3
EDGE_RATIO = 1.1

REGIONS = ("interior", "edge", "uncovered")
# Largest distance [px] of each region to the nearest return that was fed.
RETURN_DISTANCES: Mapping[str, float] = {
    "return_0_px": 0,
    "return_1_2_px": 2,
    "return_3_6_px": 6,
    "return_over_6_px": math.inf,
}

# Least share of known pixels around the known pixels of a dense true depth. Rendered depth has
# 0.99, the accumulated scans of KITTI's streets have 0.5.
_DENSE_SHARE = 0.9
_AROUND = (3, 3)
_BEYOND_M = 1e6  # replaces unknown depth in minima


class DepthRegionScores(Accumulator):
    """MAE and RMSE of `RETURN_DISTANCES` and `REGIONS`, over the same pixels as `DepthScores`.

    Frames without dense ground truth do not count in the `REGIONS`.
    """

    def __init__(self) -> None:
        self._sums = {region: ErrorSums() for region in (*RETURN_DISTANCES, *REGIONS)}

    def update(self, errors: DepthErrors, fed: NDArray[np.floating]) -> None:
        """Count a frame by its errors and the depth that was fed, float (H, W), 0 = no return."""
        to_return_px = distance_px(fed > 0)
        regions = split_distances(to_return_px)
        if is_dense(errors.depth):
            regions |= split_regions(errors.depth, to_return_px)
        for region, mask in regions.items():
            self._sums[region].add(errors.error[mask[errors.known]])

    def figures(self) -> dict[str, float]:
        """Return the errors [m] of all frames so far."""
        figures: dict[str, float] = {}
        for region, sums in self._sums.items():
            figures |= sums.figures(f"m_{region}")
        return figures


def is_dense(depth: NDArray[np.floating]) -> bool:
    """Return whether a true depth (H, W) [m] is dense where it is known; False if none is known."""
    known = scored(depth, math.inf)
    if not known.any():
        return False
    around = cv2.blur(known.astype(np.float32), _AROUND, borderType=cv2.BORDER_REPLICATE)
    return bool(around[known].mean() >= _DENSE_SHARE)


def split_distances(to_return_px: NDArray[np.float32]) -> dict[str, NDArray[np.bool_]]:
    """Return the mask, bool (H, W), of each of `RETURN_DISTANCES`; they do not overlap.

    `to_return_px`, (H, W), is the distance to the nearest return that was fed.
    """
    masks, above = {}, -1.0
    for region, limit in RETURN_DISTANCES.items():
        masks[region] = (to_return_px > above) & (to_return_px <= limit)
        above = limit
    return masks


def split_regions(
    depth: NDArray[np.floating], to_return_px: NDArray[np.float32]
) -> dict[str, NDArray[np.bool_]]:
    """Return the mask, bool (H, W), of each of the `REGIONS`; every pixel is in one of them.

    `depth` is the dense true depth, and `to_return_px` is that of `split_distances`.
    """
    covered = to_return_px <= RETURN_REACH_PX
    at_edge = distance_px(depth_edges(depth)) <= EDGE_REACH_PX
    return {"interior": covered & ~at_edge, "edge": covered & at_edge, "uncovered": ~covered}


def depth_edges(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return where a dense true depth (H, W) [m] has an edge."""
    known = scored(depth, math.inf)
    window = np.ones(_AROUND, np.uint8)
    far = cv2.dilate(np.where(known, depth, 0).astype(np.float32), window)
    near = cv2.erode(np.where(known, depth, _BEYOND_M).astype(np.float32), window)
    edges: NDArray[np.bool_] = far > EDGE_RATIO * near
    return edges


def distance_px(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the distance of every pixel to the nearest of the mask; infinite if it is empty."""
    if not mask.any():  # OpenCV's distance would be finite
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(
        cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    )
