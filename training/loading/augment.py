"""Joint augmentation: one random change of RGB, depth, labels and intrinsics together."""

from collections.abc import Sequence

from numpy.random import Generator

from training.datasets.sample import Sample, nothing_known
from training.lidar.faults import add_false_returns
from training.loading.augment_config import AugmentConfig
from training.loading.camera_faults import spoil_at_random
from training.loading.colors import change_colors
from training.loading.depth_values import DepthTarget, canonical_depth
from training.loading.geometric import cut, flip, scale_and_crop
from training.loading.lidar_input import draw_lidar


def augment(
    sample: Sample, config: AugmentConfig, rng: Generator, target: DepthTarget, rare: Sequence[int]
) -> Sample:
    """Return a randomly changed sample; a pure function of its arguments.

    Args:
        sample: a frame of a data set.
        config: ranges and probabilities.
        rng: source of all random numbers.
        target: unit of the depth, see `canonical_depth`.
        rare: ids of the rare classes, see `config.rare_crops`.

    Returns:
        A sample of size `config.drawn_size` with a sparse depth.
    """
    # With canonical depth, images without intrinsics count as taken by the canonical camera. Its
    # focal length is fixed, so a magnified image is an image taken closer to the scene.
    is_closer = target.canonical_focal_px is not None and sample.intrinsics is None
    sample = scale_and_crop(sample, config, rng, is_closer=is_closer, rare=rare)
    if rng.random() < config.flip:
        sample = flip(sample)
    sample = draw_lidar(sample, config, rng)
    if target.canonical_focal_px is not None:
        sample = canonical_depth(sample, target.canonical_focal_px, target.max_depth_m)
    sample = sample.with_image(change_colors(sample.rgb, config, rng))
    return _disturb_camera(sample, config.camera_fault, config, rng)


def _disturb_camera(
    sample: Sample, probability: float, config: AugmentConfig, rng: Generator
) -> Sample:
    if not probability or rng.random() >= probability:
        return sample
    return sample.with_image(spoil_at_random(sample.rgb, config.camera_fault_strength, rng))


def take_views(
    sample: Sample, config: AugmentConfig, rng: Generator, *, step: int
) -> tuple[Sample, Sample, tuple[int, int]]:
    """Return two views of `config.size` and the offset (rows, columns) [px] of the second.

    The offset is a multiple of `step`. `sample` has the size of `config.drawn_size`; the first view
    is its upper left corner. The LiDAR input of the second view is missing or has false returns,
    and its camera is faulty, with the probabilities of `config`.
    """
    top, left = (step * int(count) for count in rng.integers(0, config.pair_shift // step + 1, 2))
    draw = rng.random()
    fed = sample.returns
    if draw < config.pair_lidar_missing:
        fed = nothing_known(sample.size)
    elif draw < config.pair_lidar_missing + config.pair_lidar_false:
        assert fed is not None
        fed = add_false_returns(fed, rng)
    second = cut(sample.with_returns(fed), top, left, config.size)
    second = _disturb_camera(second, config.pair_camera_fault, config, rng)
    return cut(sample, 0, 0, config.size), second, (top, left)
