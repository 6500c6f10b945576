"""Changes of a sample's depth: its unit, the size of the world, and the sky."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.random import Generator

from runtime.contract.contract import MAX_RETURN_M, farthest_return
from training.datasets.sample import Sample
from training.lidar.split import masked
from training.loading.augment_config import AugmentConfig

# A depth map with more than this share of known pixels is dense, and a LiDAR is simulated from it.
# Accumulated scans know 20 % of the pixels, rendered streets at least 33 %.
_DENSE_SHARE = 0.3
# Sky pixels this close to another class have no depth target. The second margin is for labels that
# a network made.
SKY_MARGIN_PX, PSEUDO_SKY_MARGIN_PX = 2, 10


@dataclass(frozen=True)
class DepthTarget:
    """The unit of the depth target, see `models.NetworkConfig`, and the depth of the sky.

    Attributes:
        sky: class whose unmeasured pixels get the depth `sky_depth_m`; None: no class.
        max_depth_m: range of the network.
    """

    canonical_focal_px: float | None = None
    sky: int | None = None
    sky_depth_m: float = 100.0
    max_depth_m: float = MAX_RETURN_M


def scale_world(
    views: Sequence[Sample], config: AugmentConfig, rng: Generator, *, max_depth_m: float
) -> tuple[Sample, ...]:
    """Multiply all depth of a frame's views by one random factor of `config.world_scale`.

    Without returns in each view nothing changes: then the scale is learned from the image. Returns
    beyond `max_depth_m`, in the unit of the samples, are clipped to it.
    """
    low, high = config.world_scale
    fed = (view.returns for view in views)
    if low == high == 1 or not all(depth is not None and depth.any() for depth in fed):
        return tuple(views)
    factor = float(np.exp(rng.uniform(*np.log((low, high)))))
    return tuple(scale_depth(view, factor, max_depth_m) for view in views)


def canonical_depth(sample: Sample, focal_px: float, max_depth_m: float) -> Sample:
    """Multiply all depth by `focal_px` / fx, the depth for a camera of this focal length [px].

    Things of the same size in the image then have the same depth, whatever the camera (Yin et al.
    2023, Metric3D, Sec. 3.2, "CSTM label"). Returns beyond `max_depth_m`, the network's range in
    canonical metres, are clipped to it or dropped as by the engine, see `farthest_return`. The
    intrinsics do not change; without intrinsics nothing does.
    """
    focal = sample.focal_length_px
    if focal is None:
        return sample
    factor = focal_px / focal
    if (fed := sample.returns) is not None:  # `farthest_return` is in metres
        sample = sample.with_returns(masked(fed, fed <= farthest_return(max_depth_m / factor)))
    return scale_depth(sample, factor, max_depth_m)


def scale_depth(sample: Sample, factor: float, farthest: float = np.inf) -> Sample:
    """Multiply all depth by a factor; returns then beyond `farthest` are set to it."""
    if "depth" in sample.targets:
        sample = sample.with_targets(depth=sample.depth * np.float32(factor))
    if sample.returns is None:
        return sample
    fed = np.minimum(sample.returns * np.float32(factor), np.float32(farthest))
    return sample.with_returns(fed)


def far_sky(sample: Sample, sky: int, depth_m: float) -> Sample:
    """Set the depth target of the class `sky` to `depth_m`, in the unit of the sample's depth.

    Measured pixels do not change. Pixels within `SKY_MARGIN_PX` of another class do not change
    (`PSEUDO_SKY_MARGIN_PX` if a network made the labels), because leaves and wires in front of the
    sky are labelled as sky. A sample without any depth does not change: its only targets would be
    far. Call this after simulating the LiDAR.
    """
    if not sample.depth.any():
        return sample
    unmeasured = sample.depth == 0
    if sample.returns is not None:
        unmeasured &= sample.returns == 0
    margin = SKY_MARGIN_PX if sample.weights.get("semantic", 1) == 1 else PSEUDO_SKY_MARGIN_PX
    window = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    inner = cv2.erode((sample.semantic == sky).astype(np.uint8), window) > 0
    is_sky = unmeasured & inner
    return sample.with_targets(depth=np.where(is_sky, np.float32(depth_m), sample.depth))


def has_dense_depth(sample: Sample) -> bool:
    """Whether the depth is known for most surfaces, as rendered depth is, and not a scan."""
    known = int(np.count_nonzero(sample.depth))
    return not sample.is_scan and known > _DENSE_SHARE * sample.depth.size
